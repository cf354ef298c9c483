"""What is grasped: an object with its distances, and where and which way round people take it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.sdf_grid import SDFGrid

# A part is slender when this many times as long as it is wide, and at least so many metres long.
SLENDER_RATIO, SLENDER_LENGTH = 1.8, 0.045


@dataclass(frozen=True)
class Part:
    """A part of an object that is grasped on purpose.

    low, high: (3,) its box, metres, object frame. weight: share of grasps. points, normals: (N, 3) surface samples.
    axis: (3,) its longest direction. slender: whether it has a marked one. forward: (3,) where the thumb's side of the
    hand belongs (the head of a hammer), zero where it doesn't matter.
    """

    low: Tensor
    high: Tensor
    weight: float
    points: Tensor
    normals: Tensor
    axis: Tensor
    slender: bool
    forward: Tensor


class GraspedObject:
    """One object, at rest in its own frame.

    Attributes:
        name: of the object.
        mesh: metres.
        parts: where it is taken.
        floor: height of the table that it rests on, metres.
    """

    def __init__(self, name: str, mesh: Mesh, parts: list[Part], cache_dir: str | Path | None = None):
        self.name, self.mesh, self.parts = name, mesh, parts
        self.floor = float(mesh.vertices[:, 2].min())
        self._atlas = SDFAtlas([SDFGrid.load_or_build(mesh, cache_dir)])

    def distance(self, points: Tensor) -> Tensor:
        """Signed distance (B, N), metres, of points (B, N, 3)."""
        return self._atlas(points, torch.zeros(len(points), dtype=torch.int64))

    def distance_and_normal(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Signed distances (B, N), metres, and their gradients (B, N, 3), of points (B, N, 3)."""
        return self._atlas.with_gradient(points, torch.zeros(len(points), dtype=torch.int64))

    def thickness(
        self, point: Tensor, direction: Tensor, full: Tensor, reach: float = 0.10, step: float = 1e-3
    ) -> Tensor:
        """(N,) metres from surface points inwards to where the object ends: the last exit where `full`, else the first.

        Args:
            point, direction: (N, 3) on the surface, and unit vectors into the object.
            full: (N,) bool. reach: metres beyond which nothing is sought, in steps of `step`.
        """
        depth = torch.arange(1, int(reach / step) + 1) * step
        outside = self.distance(point.unsqueeze(1) + direction.unsqueeze(1) * depth.unsqueeze(1)) >= 0
        last = torch.where(outside, 0.0, depth).amax(1)
        gap = outside & (depth > 2 * step)
        first = torch.where(gap.any(1), depth[gap.int().argmax(1)], reach)
        return torch.where(full, last, torch.minimum(first, last))


def part(mesh: Mesh, low: np.ndarray, high: np.ndarray, weight: float, n_points: int, seed: int) -> Part:
    """The surface of `mesh` inside a box, sampled."""
    points, normals = mesh.sample_surface(8 * n_points, seed)
    inside = ((points >= low) & (points <= high)).all(1)
    points, normals = points[inside][:n_points], normals[inside][:n_points]
    offset = points - points.mean(0)
    _, _, directions = np.linalg.svd(offset, full_matrices=False)
    # By extent, not by variance: a thin plate's rim would mislead that.
    length, width = np.ptp(offset @ directions[0]), np.ptp(offset @ directions[1])
    slender = bool(length > SLENDER_RATIO * width and length > SLENDER_LENGTH)
    axis = directions[0] * np.sign(directions[0][np.abs(directions[0]).argmax()])
    # Long lying objects are held at their −x end: the thumb's side of the hand points to the other.
    at_rear = points.mean(0)[0] < mesh.bounds.mean(0)[0] - 0.1 * mesh.extents[0]
    forward = axis * float(slender and axis[0] > 0.8 and at_rear)
    return Part(
        *(torch.as_tensor(x, dtype=torch.float32) for x in (low, high)),
        weight,
        *(torch.as_tensor(x, dtype=torch.float32) for x in (points, normals, axis)),
        slender,
        torch.as_tensor(forward, dtype=torch.float32),
    )
