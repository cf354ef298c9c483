"""Catch trials: recorded grasps moved until they are measurably implausible (paper S.9.4)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch

from grabnet.cli.checks import Positive, Weight, in_range
from grabnet.errors import UserError
from grabnet.evaluation.hands import Hands
from grabnet.evaluation.recorded import held_out
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery

# Points on the object's surface that are looked for inside the hand.
_POINTS = 8000
KINDS = ("through", "apart")


@dataclass(frozen=True)
class CatchConfig:
    """When a grasp counts as implausible. All in metres.

    depth: by which the object's surface runs inside the hand, or the hand inside the object.
    beyond: that a hand is moved on from there, so that one sees it.
    gap: between hand and object.
    step: by which a hand is moved at a time.
    reach: that it is moved at most; a grasp that is not implausible by then is not used.

    Raises:
        UserError: a value out of range.
    """

    depth: Positive
    beyond: Weight
    gap: Positive
    step: Positive
    reach: Positive

    def __post_init__(self):
        in_range(self, "catch.")
        if self.reach < self.step:
            raise UserError(f"catch.reach is {self.reach}; it must be at least catch.step, {self.step}.")


class Measured(NamedTuple):
    """Of a hand on an object, metres.

    depth: of the deepest point of either surface inside the other; 0 where none is inside.
    gap: between the surfaces; 0 where they cut each other.
    """

    depth: float
    gap: float


class Catches:
    """Makes catch trials for one object.

    Args:
        mesh: metres.
        config: when they count as implausible.
        seed: of the points on the object's surface.
    """

    def __init__(self, mesh: Mesh, config: CatchConfig, seed: int):
        self.config = config
        self._query = MeshQuery(mesh)
        rng = np.random.default_rng([seed, 5])
        a, b, c = np.moveaxis(mesh.triangles.astype(np.float64), 1, 0)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        chosen = rng.choice(len(area), _POINTS, p=area / area.sum())
        u, v = np.sqrt(rng.random((_POINTS, 1))), rng.random((_POINTS, 1))
        self._surface = (1 - u) * a[chosen] + u * (1 - v) * b[chosen] + u * v * c[chosen]

    def measure(self, vertices: np.ndarray, faces: np.ndarray) -> Measured:
        """Measure a closed hand: vertices (V, 3), faces (F, 3)."""
        of_hand = self._query.signed_distance(torch.as_tensor(vertices, dtype=torch.float32))
        of_object = MeshQuery(Mesh(vertices, faces)).signed_distance(torch.as_tensor(self._surface).float())
        least = float(min(of_hand.min(), of_object.min()))
        return Measured(depth=max(0.0, -least), gap=max(0.0, least))

    def make(self, truth: Hands, n: int, seed: int) -> tuple[np.ndarray, list[dict[str, Any]]]:
        """Return n implausible hands, closed, (n, V, 3), in turn through the object and apart from it, and how each was
        made.

        Args:
            truth: recorded grasps; each is used once at most, those held out first.
            n: of them.
            seed: of the choice.

        Raises:
            UserError: too few grasps become implausible.
        """
        hands, made = [], []
        candidates = _shuffled(truth, seed)
        while len(made) < n:
            kind = KINDS[len(made) % len(KINDS)]
            for source in candidates:
                found = self._moved(truth, source, kind)
                if found is not None:
                    hands.append(found[0])
                    made.append({"kind": kind, "source": int(source), **found[1]})
                    break
            else:
                raise UserError(
                    f"Only {len(made)} of {n} catch trials become implausible: lower catches, catch.depth or catch.gap."
                )
        return np.stack(hands) if hands else np.empty((0, *truth.closed[0].shape[1:]), np.float32), made

    def _moved(self, truth: Hands, source: int, kind: str) -> tuple[np.ndarray, dict[str, Any]] | None:
        vertices, faces = truth.closed[0][source], truth.closed[1]
        palm = vertices.mean(0, keepdims=True)
        nearest = self._query.closest(torch.as_tensor(palm, dtype=torch.float32)).position.numpy()
        towards = (nearest - palm)[0] / max(np.linalg.norm(nearest - palm), 1e-9)
        direction = towards if kind == "through" else -towards
        onwards = self.config.beyond if kind == "through" else 0.0
        distance = self.config.step
        while distance <= self.config.reach + 1e-9:
            moved = (vertices + distance * direction).astype(np.float32)
            measured = self.measure(moved, faces)
            if measured.depth >= self.config.depth if kind == "through" else measured.gap >= self.config.gap:
                if not onwards:
                    return moved, {"moved": [float(v) for v in distance * direction], **measured._asdict()}
                distance, onwards = distance + onwards, 0.0
            else:
                distance += self.config.step
        return None


def _shuffled(truth: Hands, seed: int) -> Iterator[int]:
    """Numbers of recorded grasps at random, those held out first: the condition "Ground truth" shows none of them."""
    apart = held_out(truth)
    order = np.random.default_rng([seed, 6]).permutation(len(truth))
    return iter([*order[apart[order]], *order[~apart[order]]])
