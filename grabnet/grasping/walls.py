"""How far a posed hand is through walls and through itself, where the depth of its vertices does not show it."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from grabnet.grasping.grasp_hand import GraspHand, Posed
from grabnet.grasping.spheres import overlaps


def depth_through_walls(
    signed_distance: Callable[[Tensor], Tensor], hand: GraspHand, posed: Posed, steps: int = 7
) -> Tensor:
    """(B, V) mm of the line from the point inside the hand to each vertex, beyond where it first enters the object.

    Signed distance at the vertex cannot show that a fingertip has come out of a thin wall on the other side; this can.
    """
    foot = posed.spheres[:, hand.foot]
    line = posed.vertices - foot
    length = line.norm(dim=-1) * 1e3
    entry = torch.ones_like(length)
    for share in torch.linspace(1, 0.3, steps).tolist():
        distance = signed_distance(foot + share * line) * 1e3
        here = (share + distance / length.clamp_min(1)).clamp(0, 1)
        entry = torch.where(distance < -0.2, here, entry)
    return (1 - entry) * length


def crossing(hand: GraspHand, posed: Posed) -> Tensor:
    """(B,) mm by which a finger is inside another (skin against spheres) or inside the palm (spheres, 2 mm allowed)."""
    phalanx = (hand.sphere_bone - 1) % 3
    sphere_finger = torch.where((hand.sphere_bone > 0) & (phalanx > 0), (hand.sphere_bone - 1) // 3, -1)
    bone = hand.anatomy.bone
    skin_finger = torch.where((bone > 0) & ((bone - 1) % 3 > 0), (bone - 1) // 3, -1)
    deepest = []
    for finger in range(5):
        skin = posed.vertices[:, skin_finger == finger]
        others = (sphere_finger >= 0) & (sphere_finger != finger)
        inside = hand.radii[others] - torch.cdist(skin, posed.spheres[:, others])
        deepest.append(inside.amax((1, 2)))
    spheres = overlaps(posed.spheres, hand.apart).amax((1, 2))
    return torch.stack([*(1e3 * d for d in deepest), spheres - 2]).amax(0)
