"""Exact distances from points to a mesh."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from grabnet.geometry import kernels
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.warping import launch


class Closest(NamedTuple):
    """Nearest surface points: position (N, 3), distance (N,), face (N,) int64.

    Where nothing lies within the distance asked for: NaN, infinity, -1.
    """

    position: Tensor
    distance: Tensor
    face: Tensor


class MeshQuery:
    """Distances to one mesh, exact to float32.

    Inside is where the winding number exceeds one half: right for closed meshes, overlapping parts and, unlike tests
    by rays or normals, for open ones, whose openings are closed as by a membrane. A mesh whose faces look inward is
    taken as turned outward.

    Args:
        mesh: in metres or any other unit; distances come back in the same.
        device: where the queries run; the points must lie there too.
    """

    def __init__(self, mesh: Mesh, device: torch.device | str = "cpu"):
        self.device = torch.device(device)
        faces = mesh.faces if mesh.volume >= 0 else mesh.faces[:, ::-1]
        on = wp.device_from_torch(self.device)
        self._mesh = wp.Mesh(
            wp.array(mesh.vertices, dtype=wp.vec3, device=on),
            wp.array(faces.flatten(), dtype=wp.int32, device=on),
            support_winding_number=True,
        )

    def signed_distance(self, points: Tensor, max_distance: float = math.inf) -> Tensor:
        """Distances (N,) of points (N, 3) to the surface, negative inside; +inf beyond `max_distance`, in or out."""
        points = _prepared(points)
        distance = points.new_full((len(points),), math.inf)
        launch(kernels.signed_distance, [points, distance], [self._mesh.id, max_distance])
        return distance

    def closest(self, points: Tensor, max_distance: float = math.inf) -> Closest:
        """Nearest surface point of each of points (N, 3), not further than `max_distance`; a small one is faster."""
        points = _prepared(points)
        distance = points.new_full((len(points),), math.inf)
        position = torch.full_like(points, math.nan)
        face = torch.full_like(distance, -1, dtype=torch.int32)
        launch(kernels.closest_point, [points, distance, position, face], [self._mesh.id, max_distance])
        return Closest(position, distance, face.long())


def _prepared(points: Tensor) -> Tensor:
    return points.detach().float().contiguous()
