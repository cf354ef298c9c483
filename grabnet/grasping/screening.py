"""The cheap half of what grasps are like, to choose among many candidates: by interpolated distances, in batches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from grabnet.grasping.grasp_hand import GraspHand, Posed
from grabnet.grasping.interior import Interior
from grabnet.grasping.joints import beyond_limits
from grabnet.grasping.walls import crossing, depth_through_walls

_CORE = 0.45  # of a finger's radius, within which its bone is
_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the way between two spheres, where the object is looked for


@dataclass(frozen=True, eq=False, kw_only=True)
class Screening:
    """Of N candidates, (N,) each, on the device of the hands.

    Attributes:
        distances: (N, V) metres, signed, of the skin.
        depth_mm: of the deepest vertex in the object.
        through_mm: as `GraspMeasures` has it, as far as seven steps along each line show it.
        bone_mm: by how much the object is nearer to a bone than the core of a finger is thick; 0 where clear.
        crossing_mm, joint_excess_deg: as `GraspMeasures` has them.
    """

    distances: Tensor
    depth_mm: Tensor
    through_mm: Tensor
    bone_mm: Tensor
    crossing_mm: Tensor
    joint_excess_deg: Tensor


@torch.no_grad()
def screen(
    hand: GraspHand,
    interior: Interior,
    posed: Posed,
    hand_pose: Tensor,
    distance_and_normal: Callable[[Tensor], tuple[Tensor, Tensor]],
) -> Screening:
    """Measure candidates.

    Args:
        hand: that was posed.
        interior: of the same.
        posed: N hands, metres.
        hand_pose: (N, 15, 3, 3) rotations of their joints.
        distance_and_normal: signed distances (N, P), metres, and outward normals (N, P, 3) of points (N, P, 3).
    """
    distances, _ = distance_and_normal(posed.vertices)
    start, end = interior.chain.T
    shares = posed.spheres.new_tensor(_SHARES).view(-1, 1, 1)
    bones = torch.lerp(posed.spheres[:, None, start], posed.spheres[:, None, end], shares)
    core = _CORE * torch.lerp(hand.radii[None, start], hand.radii[None, end], shares.squeeze(-1))
    to_bones = distance_and_normal(bones.flatten(1, 2))[0]
    through = depth_through_walls(lambda x: distance_and_normal(x)[0], hand, posed)
    return Screening(
        distances=distances,
        depth_mm=1e3 * (-distances).amax(1).clamp_min(0),
        through_mm=through.amax(1),
        bone_mm=1e3 * (core.flatten() - to_bones).amax(1).clamp_min(0),
        crossing_mm=crossing(hand, posed).clamp_min(0),
        joint_excess_deg=beyond_limits(hand.anatomy, hand_pose)[0].amax(1),
    )
