"""Rotation conversions (roma does the mathematics; here are the field's conventions).

Rotations are matrices (..., 3, 3) throughout the code, acting on column vectors: `y = R x`, or `points @ R.mT` for
row-wise points. Other parametrisations live at the edges only: axis-angle on disk, 6-D in the networks.
"""

from __future__ import annotations

import roma
import torch
from torch import Tensor


def axis_angle_to_matrix(axis_angle: Tensor) -> Tensor:
    """(..., 3) rotation vectors in radians → (..., 3, 3)."""
    return roma.rotvec_to_rotmat(axis_angle)


def matrix_to_axis_angle(matrix: Tensor) -> Tensor:
    """(..., 3, 3) → (..., 3) rotation vectors in radians, of length at most π."""
    return roma.rotmat_to_rotvec(matrix)


def six_d_to_matrix(six_d: Tensor) -> Tensor:
    """(..., 6) → (..., 3, 3): the six numbers viewed as 3×2, Gram–Schmidt on its columns (ref. 6).

    Columns that are zero or parallel have no Gram–Schmidt basis: there the result is no rotation, but it and its
    gradient stay finite (an untrained network does emit such numbers).
    """
    columns = six_d.unflatten(-1, (3, 2))
    a, b = columns[..., 0], columns[..., 1]
    x = _unit(a)
    y = _unit(b - (x * b).sum(-1, keepdim=True) * x)
    return torch.stack([x, y, torch.linalg.cross(x, y, dim=-1)], dim=-1)


def matrix_to_six_d(matrix: Tensor) -> Tensor:
    """(..., 3, 3) → (..., 6): the first two columns, row-major as 3×2; the inverse of `six_d_to_matrix`."""
    return matrix[..., :2].flatten(-2)


def about_z(angle: Tensor) -> Tensor:
    """(...) angles in radians → (..., 3, 3) rotations about the vertical."""
    c, s, o = angle.cos(), angle.sin(), torch.zeros_like(angle)
    rows = [torch.stack(row, -1) for row in ((c, -s, o), (s, c, o), (o, o, torch.ones_like(angle)))]
    return torch.stack(rows, -2)


def random_rotations(n: int, generator: torch.Generator | None = None, dtype: torch.dtype = torch.float32) -> Tensor:
    """(n, 3, 3) rotations, uniform over SO(3)."""
    return quaternion_to_matrix(torch.randn(n, 4, generator=generator, dtype=dtype))


def quaternion_to_matrix(quaternion: Tensor) -> Tensor:
    """(..., 4) quaternions of any length, real part last → (..., 3, 3); of standard normals, uniform over SO(3)."""
    return roma.unitquat_to_rotmat(quaternion / quaternion.norm(dim=-1, keepdim=True))


def _unit(vector: Tensor) -> Tensor:
    return vector / vector.square().sum(-1, keepdim=True).clamp_min(1e-16).sqrt()
