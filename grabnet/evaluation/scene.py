"""Hands on one object, and what several protocols want to know of them, found once."""

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

# Metres: of vertices farther than this from the object's bounding box nothing more is said than that they are far.
_REACH = 0.02

Value = TypeVar("Value")


class Target:
    """An object prepared for measuring; what costs time is done when first asked for, and kept.

    Args:
        mesh: metres, closed or open.
    """

    def __init__(self, mesh: Mesh):
        self.mesh = mesh
        self._kept: dict[Hashable, Any] = {}

    def kept(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """What `make` gave when first asked for by this key."""
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]

    @property
    def query(self) -> MeshQuery:
        return self.kept("query", lambda: MeshQuery(self.mesh))

    def voxels(self, spacing: float) -> Runs:
        """Voxels inside."""
        return self.kept(("voxels", spacing), lambda: inside(self.mesh, spacing, self.query))


class Scene:
    """Hands on a target."""

    def __init__(self, target: Target, hands: Hands):
        self.target, self.hands = target, hands
        self._crossings: dict[float, list[RayCrossings]] = {}

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
        """Of each hand, its wrist closed, with the columns of voxels."""
        if spacing not in self._crossings:
            vertices, faces = self.hands.closed
            self._crossings[spacing] = [RayCrossings.of(hand, faces, spacing) for hand in vertices]
        return self._crossings[spacing]

    def shared_volume(self, spacing: float) -> np.ndarray:
        """(N,) m³: voxels whose centres lie inside both hand and object."""
        solid = self.target.voxels(spacing)
        return np.array([solid.shared(c.inside()) for c in self.crossings(spacing)], float) * spacing**3
