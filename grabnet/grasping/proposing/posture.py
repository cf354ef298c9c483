"""Which ways a person in front of a table holds a hand."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class PostureConfig:
    """Bounds on the heights (cosines with the vertical) of directions fixed to the hand."""

    forearm_on_table: float = 0.0  # the forearm rises from a hand that takes something off the table
    forearm_held: float = -0.55  # of a lifted object the elbow may be below the hand
    palm: float = 0.3  # the palm faces down or sideways, seldom a little up
    thumb: float = -0.25  # the thumb's side is not below the little finger's
    forward: float = 0.15  # cosine between the thumb's side and the working end of a tool


def discomfort(rotation: Tensor, frame: Tensor, on_table: Tensor, forward: Tensor, config: PostureConfig) -> Tensor:
    """(B,) by how much hands of wrist rotation (B, 3, 3) leave the natural postures, sum of cosines; 0 within.

    Args:
        frame: (3, 3) rows distal, palmar and radial of the hand at rest (`Anatomy.frame`).
        on_table: (B,) bool, the object stands on the table.
        forward: (B, 3) where the thumb's side should point; zero where that doesn't matter.
    """
    distal, palmar, radial = (rotation @ frame.mT).unbind(-1)
    forearm, palm, thumb = -distal[:, 2], palmar[:, 2], radial[:, 2]
    lowest = torch.where(on_table, config.forearm_on_table, config.forearm_held)
    matters = forward.square().sum(-1) > 0
    ahead = (radial * forward).sum(-1)
    backward = torch.where(matters, config.forward - ahead, torch.zeros_like(ahead))
    return sum(x.relu() for x in (lowest - forearm, palm - config.palm, config.thumb - thumb, backward))
