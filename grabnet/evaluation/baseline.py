"""The naive baseline: what someone would do without a network who has the training grasps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from grabnet.evaluation.cache import Cache
from grabnet.evaluation.hands import Hands
from grabnet.geometry.bps import BPS
from grabnet.geometry.mesh import Mesh, load_mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.rotations import about_z
from grabnet.io.files import sha256

# Ways the object is turned about its vertical to look like another.
_TURNS = 24


class Lookalike(NamedTuple):
    """A training object's number, and the turn about the vertical, radians, that makes the other look most like it."""

    number: int
    turn: float


def lookalike(mesh: Mesh, training: Sequence[Path], cache: Cache) -> Lookalike:
    """Return the training object of the most similar basis point set.

    That is the least sum of squared differences, over turns of `mesh` by multiples of 15° about its vertical, all
    objects centred at their centroids and standing as in their files.

    Args:
        mesh: metres.
        training: mesh files.
        cache: of results.
    """

    def find() -> dict[str, np.ndarray]:
        bps = BPS()
        angles = torch.arange(_TURNS) * (2 * torch.pi / _TURNS)
        own = _features(bps, mesh, about_z(angles))
        others = torch.cat([_of_file(bps, file, cache) for file in training])
        difference = torch.cdist(own.double(), others.double())
        turn, number = divmod(int(difference.argmin()), len(training))
        return {"number": np.array(number), "turn": angles[turn].numpy()}

    nearest = cache.get("lookalike", [mesh.sha256, *map(sha256, training)], find)
    return Lookalike(int(nearest["number"]), float(nearest["turn"]))


def transplanted(hands: Hands, source: Mesh, mesh: Mesh, turn: float) -> Hands:
    """Return grasps of `source` about `mesh` instead: about its centroid, and turned back by `turn`."""
    vertices = (hands.vertices - source.centroid) @ about_z(torch.tensor(turn)).numpy() + mesh.centroid
    return Hands(vertices=vertices.astype(np.float32), faces=hands.faces, hand_pose=hands.hand_pose)


def _of_file(bps: BPS, file: Path, cache: Cache) -> torch.Tensor:
    """(1, P) features of a mesh as it stands."""

    def features() -> dict[str, np.ndarray]:
        return {"bps": _features(bps, load_mesh(file), torch.eye(3)[None]).numpy()}

    return torch.from_numpy(cache.get("bps", [sha256(file)], features)["bps"])


def _features(bps: BPS, mesh: Mesh, rotations: torch.Tensor) -> torch.Tensor:
    """(R, P) exact basis point features of a mesh in several attitudes."""
    query, centroid = MeshQuery(mesh), torch.as_tensor(mesh.centroid)
    return torch.stack([bps.from_mesh(query, rotation, centroid) for rotation in rotations])
