"""Exact nearest neighbours between point sets small enough for brute force, in pieces that stay in the cache."""

from __future__ import annotations

import torch
from torch import Tensor

# Distances formed at a time. On CPUs pieces of a few MB are several times faster than one large product.
_PIECE = 1 << 21


@torch.no_grad()
def nearest(queries: Tensor, points: Tensor) -> Tensor:
    """Index (B, Q) of the nearest of `points` (B, N, 3) to each of `queries` (B, Q, 3)."""
    squares = points.square().sum(-1).unsqueeze(1)
    index = torch.empty(queries.shape[:2], dtype=torch.long, device=queries.device)
    step = (
        max(1, _PIECE // max(1, queries.shape[1] * points.shape[1])) if queries.device.type == "cpu" else len(queries)
    )
    for start in range(0, len(queries), max(step, 1)):
        part = slice(start, start + step)
        # |p|² - 2 q·p orders the points as the distance does.
        torch.argmin(torch.baddbmm(squares[part], queries[part], points[part].mT, alpha=-2), dim=-1, out=index[part])
    return index


def signed_offset(queries: Tensor, points: Tensor, normals: Tensor) -> Tensor:
    """Distance (B, Q) to the nearest of `points`, negative behind that point's normal; differentiable.

    Args:
        queries: (B, Q, 3). points, normals: (B, N, 3) vertices of a closed surface and their outward normals.
    """
    index = nearest(queries, points).unsqueeze(-1).expand(-1, -1, 3)
    offset = queries - points.gather(1, index)
    outside = (offset.detach() * normals.gather(1, index)).sum(-1) >= 0
    distance = (offset.square().sum(-1) + 1e-12).sqrt()  # a gradient at distance 0 too
    return torch.where(outside, distance, -distance)
