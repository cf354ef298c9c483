"""Rigid alignment of corresponding points, and the motion of objects by their markers (paper 3.2)."""

from __future__ import annotations

import torch
from torch import Tensor

# Below this ratio of second to first singular value the points lie on a line, and the turn about it is free.
_COLLINEAR = 1e-3


def align(source: Tensor, target: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Rotation and translation that move `source` onto `target` in the sense of weighted least squares (Kabsch).

    Args:
        source, target: (..., N, 3) points; of any value, NaN too, where the weight is 0.
        weights: (..., N) trust in each point, at least 0.

    Returns:
        rotation (..., 3, 3) and translation (..., 3), so that `target ≈ source @ rotation.mT + translation`; NaN where
        fewer than three points count, or all lie on a line.
    """
    enough = (weights > 0).sum(-1) >= 3
    w = (weights / weights.sum(-1, keepdim=True).clamp_min(1e-30)).unsqueeze(-1)
    source, target = torch.where(w > 0, source, 0), torch.where(w > 0, target, 0)
    source_mean, target_mean = (w * source).sum(-2, keepdim=True), (w * target).sum(-2, keepdim=True)
    covariance = (w * (target - target_mean)).mT @ (source - source_mean)
    u, s, vt = torch.linalg.svd(covariance)
    enough = enough & (s[..., 1] >= _COLLINEAR * s[..., 0]) & (s[..., 0] > 0)
    # A reflection can fit better than any rotation when points are coplanar: flip the least certain axis back.
    flip = torch.ones_like(s)
    flip[..., 2] = torch.linalg.det(u @ vt).sign()
    rotation = (u * flip.unsqueeze(-2)) @ vt
    translation = target_mean.squeeze(-2) - (rotation @ source_mean.mT).squeeze(-1)
    return (
        torch.where(enough[..., None, None], rotation, torch.nan),
        torch.where(enough.unsqueeze(-1), translation, torch.nan),
    )
