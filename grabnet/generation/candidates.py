"""Candidates: hands that a generator draws before one object, optimised if asked, of which the best are kept."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from grabnet.body.hand import HandParameters
from grabnet.geometry.placed import PlacedObjects
from grabnet.grasping.optimiser import GraspOptimiser
from grabnet.models.generator import GraspGenerator


class Candidates(NamedTuple):
    """M right hands in the right-hand world, and ways (M,) in which the object stands before them."""

    hands: HandParameters
    ways: Tensor

    @classmethod
    def cat(cls, batches: Sequence[Candidates]) -> Candidates:
        """All of several batches."""
        hands = HandParameters(*(torch.cat(x) for x in zip(*(batch.hands for batch in batches), strict=True)))
        return cls(hands, torch.cat([batch.ways for batch in batches]))

    def select(self, index: Tensor | slice) -> Candidates:
        """The chosen ones."""
        return Candidates(self.hands.select(index), self.ways[index])


def draw(
    generator: GraspGenerator,
    objects: PlacedObjects,
    n: int,
    batch_size: int,
    seed: int,
    rest: Tensor,
    optimiser: GraspOptimiser | None,
    floor: float | None = None,
) -> Iterator[Candidates]:
    """Draw n candidates in batches; the last batch is filled up.

    All is computed in full batches, since sums of products of fewer rows may round differently. Candidate i is the same
    for every n.

    Args:
        generator: makes the hands.
        objects: the object, in each of the K ways in which it stands; candidate i takes way i modulo K.
        n: candidates, at least.
        batch_size: hands at once.
        seed: of the random numbers.
        rest: (V, 3) rest vertices, metres.
        optimiser: of hands of this shape; None to leave them as they are drawn.
        floor: height of the table in the world, metres, that the optimiser keeps hands above; None where there is none.
    """
    n_filled = -(-n // batch_size) * batch_size
    noise = _noise(n_filled, generator.noise_dim, seed).to(rest.device)
    ways = torch.arange(n_filled, device=rest.device) % len(objects)
    codes = generator.encode(objects)
    for z, way in zip(noise.split(batch_size), ways.split(batch_size), strict=True):
        chosen = objects.select(way)
        hands = generator.sample(codes[way], chosen, z, rest)
        if optimiser is not None:
            # Gravity pulls where the object is centred: at the origin of its world.
            optimised = optimiser(optimiser.hand.pose_of(hands), chosen.surface, hands.transl.new_zeros(3), floor)
            hands = optimiser.hand.parameters(optimised)
        yield Candidates(hands, way)


def _noise(n: int, dim: int, seed: int) -> Tensor:
    """(n, dim) standard normal; row i depends on the seed and i alone."""
    return torch.from_numpy(np.random.default_rng([seed, 0]).standard_normal((n, dim), np.float32))
