"""Exact distances from points to a mesh, on the CPU or an NVIDIA GPU, whichever holds the points."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager, nullcontext
from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from grabnet.geometry import kernels
from grabnet.geometry.mesh import Mesh


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
        distance = self._full(points, math.inf)
        self._launch(kernels.signed_distance, points, max_distance, distance)
        return distance

    def closest(self, points: Tensor, max_distance: float = math.inf) -> Closest:
        """Nearest surface point of each of points (N, 3), not further than `max_distance`; a small one is faster."""
        distance = self._full(points, math.inf)
        position = torch.full_like(points, math.nan, dtype=torch.float32)
        face = self._full(points, -1, torch.int32)
        self._launch(kernels.closest_point, points, max_distance, distance, position, face)
        return Closest(position, distance, face.long())

    def distance_within(self, points: Tensor, bounds: Tensor) -> Tensor:
        """Unsigned distances (N,), each known beforehand to be less than its bound (N,): the fastest query."""
        distance = bounds.clone()
        self._launch(kernels.distance_within, points, wp.from_torch(bounds), distance)
        return distance

    def _full(self, points: Tensor, value: float, dtype: torch.dtype = torch.float32) -> Tensor:
        return torch.full((len(points),), value, dtype=dtype, device=self.device)

    def _launch(self, kernel: wp.Kernel, points: Tensor, bound: float | wp.array, *outputs: Tensor) -> None:
        arrays = [wp.from_torch(x, dtype=wp.vec3 if x.dim() == 2 else None) for x in outputs]
        points = wp.from_torch(points.detach().float().contiguous(), dtype=wp.vec3)
        with self._torch_stream():
            wp.launch(kernel, len(points), [self._mesh.id, points, bound, *arrays], device=self._mesh.device)

    def _torch_stream(self) -> AbstractContextManager:
        """On a GPU, queue the kernel behind the torch work that made its input."""
        if self.device.type != "cuda":
            return nullcontext()
        return wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(self.device)))
