"""How far joints are turned beyond what a hand can do."""

from __future__ import annotations

import torch
from torch import Tensor

from grabnet.body.anatomy import Anatomy


def beyond_limits(anatomy: Anatomy, hand_pose: Tensor) -> tuple[Tensor, Tensor]:
    """Degrees (N, 21) by which anatomical angles are beyond their limits, 0 within them, and (N, 15) by which joints
    turn about axes that they do not have, of joint rotations (N, 15, 3, 3)."""
    angles, left = anatomy.angles(hand_pose)
    low, high = anatomy.angle_limits.T
    return torch.rad2deg(torch.maximum(low - angles, angles - high)).clamp_min(0), torch.rad2deg(left)
