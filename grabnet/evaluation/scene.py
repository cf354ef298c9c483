"""Hands on one object, and values that several protocols need of them, computed once."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import torch

from grabnet.evaluation.hands import Hands
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.voxels import RayCrossings, Runs, inside

# Metres: vertices farther than this from the object's bounding box count as infinitely far.
_REACH = 0.02

Value = TypeVar("Value")


class _Kept:
    """Values that are computed when first asked for, and kept."""

    def __init__(self):
        self._kept: dict[Hashable, Any] = {}

    def kept(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return what `make` gave when this key was first asked for."""
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]


class GraspTarget(_Kept):
    """An object prepared for measuring.

    Args:
        mesh: metres, closed or open.
    """

    def __init__(self, mesh: Mesh):
        super().__init__()
        self.mesh = mesh

    @property
    def query(self) -> MeshQuery:
        return self.kept("query", lambda: MeshQuery(self.mesh))

    def voxels(self, spacing: float) -> Runs:
        """Return the voxels inside."""
        return self.kept(("voxels", spacing), lambda: inside(self.mesh, spacing, self.query))


class GraspScene(_Kept):
    """Hands on a target.

    Args:
        target: the object.
        hands: N of them.
        truth: recorded grasps of the object, for protocols that need them.
    """

    def __init__(self, target: GraspTarget, hands: Hands, truth: Hands | None = None):
        super().__init__()
        self.target = target
        self.hands = hands
        self.truth = truth

    @cached_property
    def distances(self) -> np.ndarray:
        """(N, V) float64 metres: exact signed distance of each hand vertex to the object's surface, negative inside;
        infinite for vertices 2 cm and more outside the object's bounding box."""
        vertices = self.hands.vertices
        low, high = self.target.mesh.bounds
        near = ((vertices > low - _REACH) & (vertices < high + _REACH)).all(-1)
        distances = np.full(near.shape, np.inf)
        if near.any():
            distances[near] = self.target.query.signed_distance(torch.from_numpy(vertices[near])).numpy()
        return distances

    def crossings(self, spacing: float) -> list[RayCrossings]:
        """Return, of each hand, its wrist closed, the crossings with the columns of voxels."""

        def find() -> list[RayCrossings]:
            vertices, faces = self.hands.closed
            return [RayCrossings.of(hand, faces, spacing) for hand in vertices]

        return self.kept(("crossings", spacing), find)

    def shared_volume(self, spacing: float) -> np.ndarray:
        """Return (N,) m³: voxels whose centres lie inside both hand and object."""
        solid = self.target.voxels(spacing)
        return np.array([solid.shared(c.inside()) for c in self.crossings(spacing)], float) * spacing**3
