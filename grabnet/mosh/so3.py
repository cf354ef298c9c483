"""Small steps on rotations: exponential, logarithm, and how the logarithm changes with a step."""

from __future__ import annotations

import torch
from torch import Tensor

from grabnet.geometry.rotations import matrix_to_axis_angle


def exp(vector: Tensor) -> Tensor:
    """(..., 3) rotation vectors, radians → (..., 3, 3) (Rodrigues); smooth at 0."""
    square = vector.square().sum(-1)[..., None, None]
    angle = square.sqrt()
    small = square < 1e-6
    safe = torch.where(small, 1.0, angle)
    first = torch.where(small, 1 - square / 6, safe.sin() / safe)
    second = torch.where(small, 0.5 - square / 24, (1 - safe.cos()) / (safe * safe))
    cross = hat(vector)
    return torch.eye(3, dtype=vector.dtype, device=vector.device) + first * cross + second * (cross @ cross)


def log(matrix: Tensor) -> Tensor:
    """(..., 3, 3) → (..., 3) rotation vectors, radians, of length at most π."""
    return matrix_to_axis_angle(matrix)


def log_change(vector: Tensor) -> Tensor:
    """(..., 3) x → (..., 3, 3): d log(exp(x)·exp(δ)) / dδ at δ = 0, the inverse of the right Jacobian of SO(3)."""
    square = vector.square().sum(-1)[..., None, None]
    angle = square.sqrt()
    small = square < 1e-4
    safe = torch.where(small, 1.0, angle)
    factor = torch.where(small, 1 / 12 + square / 720, 1 / safe**2 - (1 + safe.cos()) / (2 * safe * safe.sin()))
    cross = hat(vector)
    return torch.eye(3, dtype=vector.dtype, device=vector.device) + cross / 2 + factor * (cross @ cross)


def hat(vector: Tensor) -> Tensor:
    """(..., 3) → (..., 3, 3), the matrix whose product with y is vector × y."""
    x, y, z = vector.unbind(-1)
    o = torch.zeros_like(x)
    return torch.stack([o, -z, y, z, o, -x, -y, x, o], -1).unflatten(-1, (3, 3))
