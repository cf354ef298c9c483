"""Exact distances from points to a mesh."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from grabnet.geometry.kernels import queries as kernels
from grabnet.geometry.kernels.launch import launch
from grabnet.geometry.mesh import Mesh

# Rays cast to tell in from out: the majority decides, should one graze an edge.
_RAYS = 3
# Points on which rays must agree with the winding number.
_N_PROBES = 1000


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
    taken as turned outward. Where a mesh is closed and rays give the same answer on a sample of points, rays decide:
    they cost a third, and on the long thin faces of CAD exports a hundredth.

    Args:
        mesh: in metres or any other unit; distances come back in the same.
        device: where the queries run; the points must lie there too.

    Attributes:
        overlaps: whether the mesh is closed and parts of it were found to lie inside others.
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
        self._rays = 0
        self.overlaps = False
        if mesh.is_closed:
            points = _probes(mesh).to(self.device)
            by_winding = self.signed_distance(points)
            self._rays = _RAYS
            self.overlaps = bool((self.signed_distance(points) * by_winding < 0).any())
            if self.overlaps:
                self._rays = 0

    def signed_distance(self, points: Tensor, max_distance: float = math.inf) -> Tensor:
        """Distances (N,) of points (N, 3) to the surface, negative inside; +inf beyond `max_distance`, in or out."""
        points = _prepared(points)
        distance = points.new_full((len(points),), math.inf)
        launch(kernels.signed_distance, [points, distance], [self._mesh.id, max_distance, self._rays])
        return distance

    def closest(self, points: Tensor, max_distance: float = math.inf) -> Closest:
        """Nearest surface point of each of points (N, 3), not further than `max_distance`; a small one is faster."""
        points = _prepared(points)
        distance = points.new_full((len(points),), math.inf)
        position = torch.full_like(points, math.nan)
        face = torch.full_like(distance, -1, dtype=torch.int32)
        launch(kernels.closest_point, [points, distance, position, face], [self._mesh.id, max_distance])
        return Closest(position, distance, face.long())

    def first_hit(self, start: Tensor, end: Tensor) -> Tensor:
        """Share (N,) of the way from `start` (N, 3) to `end` (N, 3) at which it first meets the surface; +inf where it
        does not."""
        start, end = _prepared(start), _prepared(end)
        share = start.new_full((len(start),), math.inf)
        launch(kernels.first_hit, [start, end, share], [self._mesh.id])
        return share


def _probes(mesh: Mesh) -> Tensor:
    """Half of them anywhere in the bounding box, half near the surface."""
    generator = torch.Generator().manual_seed(0)
    low, high = torch.tensor(mesh.bounds)
    anywhere = low + (high - low) * torch.rand(_N_PROBES // 2, 3, generator=generator)
    surface = torch.tensor(mesh.sample_surface(_N_PROBES // 2)[0])
    offset = 0.02 * (high - low).norm() * torch.randn(surface.shape, generator=generator)
    return torch.cat([anywhere, surface + offset])


def _prepared(points: Tensor) -> Tensor:
    return points.detach().float().contiguous()
