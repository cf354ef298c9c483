"""Labels that a capture gave to the wrong markers, put right where a solved pose shows it."""

from __future__ import annotations

import torch
from torch import Tensor

_GAIN = 0.5  # of the distance to its own label: a marker moves only to a label that is nearer than this share of it


def relabelled(points: Tensor, observed: Tensor, reach: float) -> Tensor:
    """Markers under the labels that they fit, where these are not the labels they came with.

    A marker farther than `reach` from where its own label is expected takes another label within `reach`, and much
    nearer, if that label is missing or its own marker moves as well, and each is the nearest such one of the other.
    Markers that fit no label keep their own.

    Args:
        points: (F, M, 3) where each label is expected, metres.
        observed: (F, M, 3) where it was seen; NaN where missing.
        reach: metres within which a marker fits a label.

    Returns:
        (F, M, 3); NaN where a label has lost its marker to another and got none.
    """
    result = observed.clone()
    frames = ((points - observed).norm(dim=-1) > reach).any(1).nonzero().squeeze(1)
    points, observed = points[frames].double(), observed[frames].double()
    missing = observed[..., 0].isnan()
    distance = torch.cdist(points, observed.nan_to_num(torch.inf)).nan_to_num(torch.inf)  # (F, label, marker)
    own = distance.diagonal(dim1=1, dim2=2).unsqueeze(1)
    fits = (own > reach) & (distance < (_GAIN * own).clamp(max=reach))
    while True:
        moves = _matched(distance, fits)
        blocked = moves & ~(missing | moves.any(1)).unsqueeze(2)  # to a label whose own marker stays
        if not blocked.any():
            break
        fits &= ~blocked
    frame, label, marker = moves.nonzero().T
    result[frames[frame], marker] = torch.nan
    result[frames[frame], label] = observed[frame, marker].to(result.dtype)
    return result


def _matched(distance: Tensor, allowed: Tensor) -> Tensor:
    """(F, label, marker) pairs that are each other's nearest among those allowed."""
    distance = torch.where(allowed, distance, torch.inf)
    best = (distance == distance.amin(1, keepdim=True)) & (distance == distance.amin(2, keepdim=True))
    return best & allowed
