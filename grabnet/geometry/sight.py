"""What hides what: lines of sight against a mesh that moves."""

from __future__ import annotations

import math

import numpy as np
import torch
import warp as wp
from torch import Tensor

from grabnet.geometry.kernels import queries as kernels
from grabnet.geometry.kernels.launch import launch


class Occluder:
    """A mesh that moves and hides what lies behind it, exact to float32.

    Args:
        vertices: (V, 3) where it is at first, any unit.
        faces: (F, 3).
    """

    def __init__(self, vertices: Tensor, faces: np.ndarray):
        self._mesh = wp.Mesh(
            wp.array(vertices.numpy(), dtype=wp.vec3, device="cpu"),
            wp.array(np.ascontiguousarray(faces, np.int32).ravel(), dtype=wp.int32, device="cpu"),
        )

    def move(self, vertices: Tensor) -> None:
        """Put its vertices (V, 3) elsewhere."""
        wp.copy(self._mesh.points, wp.from_torch(vertices.contiguous().float(), dtype=wp.vec3))
        self._mesh.refit()

    def hides(self, start: Tensor, end: Tensor) -> Tensor:
        """(N,) bool: whether it lies between `start` (N, 3) and `end` (N, 3)."""
        share = torch.full((len(start),), math.inf)
        launch(kernels.first_hit, [start.float().contiguous(), end.float().contiguous(), share], [self._mesh.id])
        return share.isfinite()
