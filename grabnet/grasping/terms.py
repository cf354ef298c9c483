"""What a good grasp minimises, term by term, in millimetres and cosines. Each takes a batch and gives (B,) energies.

Distances to the object are signed, mm, negative inside; normals are the object's, pointing outward.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import normalize

from grabnet.grasping.seen import Pads

DEEP = 3.0  # mm of overlap, above which it costs in proportion and no longer by its square


def contact(pads: Pads, weight: Tensor, target: float, furthest: float) -> Tensor:
    """mm of pads from `target`, of weights (B, P) or (P,); a pad further than `furthest` no longer pulls."""
    off = (pads.gap - target).abs()
    off = torch.where(off < 1, 0.5 * off.square() + 0.5, off)
    return (weight * (pads.share * off).sum(-1).clamp(max=furthest)).sum(1)


def alignment(pads: Pads, weight: Tensor) -> Tensor:
    """By how much pads of weights (B, P) or (P,) do not face the surface that they touch, 1 − cosine."""
    return (weight * (1 + (pads.facing * pads.surface).sum(-1))).sum(1)


def opposition(pads: Pads, thumb: int, share: Tensor) -> Tensor:
    """By how much thumb and fingers do not press against each other across the object, cosines.

    Args:
        thumb: which pad is the thumb's.
        share: (B, P) of the other pads, sums of 1.
    """
    fingers = (share.unsqueeze(-1) * pads.place).sum(1)
    press = normalize(fingers - pads.place[:, thumb], dim=-1)  # from the thumb to the fingers
    thumb_side = (0.95 + (pads.surface[:, thumb] * press).sum(-1)).relu()
    finger_side = (0.9 - (share * (pads.surface * press.unsqueeze(1)).sum(-1)).sum(1)).relu()
    return thumb_side + finger_side


def overlap(distance: Tensor, reach: float | Tensor) -> Tensor:
    """mm² by which points at distances (B, N) are nearer to the object than `reach` (N,) mm.

    A negative reach is slack: skin that may yield. Spheres reach as far as their radius, which keeps them, other than
    skin, from coming out of a thin wall on its far side. Beyond `DEEP` it grows in proportion only, so that a hand
    that starts deep inside is not flung out.
    """
    inside = (reach - distance).relu()
    near = inside.clamp(max=DEEP)
    return (near * (2 * inside - near)).sum(1)


def below_table(height: Tensor, reach: float | Tensor) -> Tensor:
    """mm² by which points at heights (B, N) mm above the table are nearer to it than `reach` (N,) mm."""
    return (reach - height).relu().square().sum(1)


def beyond_limits(angles: Tensor, limits: Tensor) -> Tensor:
    """rad² of angles (B, A) beyond limits (A, 2)."""
    return ((limits[:, 0] - angles).relu() + (angles - limits[:, 1]).relu()).square().sum(1)


def strayed(value: Tensor, start: Tensor, scale: float = 1.0) -> Tensor:
    """Squared distance of (B, N) from the start, in units of `scale`."""
    return ((value - start) / scale).square().sum(1)
