"""Markers that break with their neighbours: seen at places where their label cannot be, whatever the pose.

Labels on one bone keep their distances. Which do is read off the recording, so that no model is needed and nothing has
to be solved before.
"""

from __future__ import annotations

import torch
from torch import Tensor

_LOOKED_AT = 200  # frames from which usual distances are taken, evenly spread: they bound the memory
_PARTNERS = 8  # labels whose distances to a label vary least
_USUAL = (0.2, 0.8)  # quantiles of a distance between which it is usual


def undoubted(observed: Tensor, margin: float) -> Tensor:
    """Markers without those in doubt.

    A marker is in doubt where at least half of its distances to the labels that usually go with its own are shorter or
    longer than they usually are, by more than a margin. A swapped label stands out against all of these, and makes its
    partners stand out against one each.

    Args:
        observed: (T, M, 3) metres; NaN where missing.
        margin: metres; infinite to doubt nothing.

    Returns:
        (T, M, 3); NaN where in doubt.
    """
    t, m, _ = observed.shape
    some = observed[:: max(1, -(-t // _LOOKED_AT))]
    between = (some.unsqueeze(1) - some.unsqueeze(2)).norm(dim=-1).flatten(1)
    low, high = between.nanquantile(between.new_tensor(_USUAL), dim=0).unflatten(1, (m, m))
    varies = (high - low).nan_to_num(torch.inf).fill_diagonal_(torch.inf)
    off, known = torch.zeros(2, t, m, device=observed.device)
    label = torch.arange(m, device=observed.device)
    for other in varies.topk(min(_PARTNERS, m - 1), largest=False).indices.T:
        distance = (observed - observed[:, other]).norm(dim=-1)
        known += distance.isfinite()
        off += (distance < low[label, other] - margin) | (distance > high[label, other] + margin)
    doubted = (off >= known / 2) & (known > 1)
    return torch.where(doubted.unsqueeze(-1), torch.nan, observed)
