"""How good candidates are: what is wrong with each, counted in millimetres."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from grabnet.body.anatomy import FINGERS
from grabnet.body.hand import HandModel, HandParameters
from grabnet.contact.contacts import Contacts
from grabnet.generation.ranking import RankingConfig
from grabnet.geometry.placed import PlacedObjects
from grabnet.grasping.forces import ForceConfig, HeldForces
from grabnet.grasping.grasp_hand import GraspHand, GraspPose
from grabnet.grasping.interior import Interior
from grabnet.grasping.screening import screen
from grabnet.grasping.seen import Seen

# mm, over which a pad's contact is spread among its vertices, and steps until contact forces are found.
_SOFTNESS, _FORCE_STEPS = 1.5, 200


class Judged(NamedTuple):
    """Parts of the score, (B,) each by name, and keypoints (B, 21, 3): joints and fingertips along the object's axes,
    from its centre, metres."""

    parts: dict[str, Tensor]
    keypoints: Tensor


def judge(
    held: GraspHand,
    interior: Interior,
    hand: HandModel,
    hands: HandParameters,
    rest: Tensor,
    objects: PlacedObjects,
    config: RankingConfig,
    forces: ForceConfig,
    contact_distance: float,
    floor: float | None = None,
) -> Judged:
    """Judge B right hands in the world of the objects; lower parts are better.

    Args:
        held: the hand's shape.
        interior: of the same.
        hand: its model.
        hands: to be judged.
        rest: (V, 3) rest vertices of the shape, metres.
        objects: B placed objects.
        config: weights.
        forces: that contacts bear.
        contact_distance: metres, below which a vertex touches.
        floor: height of the table in the world, metres; None where there is none.
    """
    vertices, joints = hand(hands, rest)
    posed = interior.posed(vertices)
    screened = screen(held, interior, posed, hands.hand_pose, objects.surface)
    contacts = Contacts(distances=screened.distances, finger=held.anatomy.finger, contact_distance=contact_distance)
    fingers = contacts.contact_vertices[:, : len(FINGERS)] > 0
    parts = {
        "depth": config.depth * (screened.depth_mm - config.depth_free).relu(),
        "through": config.through * (screened.through_mm - config.through_free).relu(),
        "bone": config.bone * screened.bone_mm,
        "crossing": config.crossing * screened.crossing_mm,
        "joints": config.joint * screened.joint_excess_deg,
        "unheld": config.unheld * (~contacts.pinched).float(),
        "force": config.force * _unmet(held, held.pose_of(hands), objects, forces),
        "fingers": -config.finger * fingers.sum(1).float(),
    }
    if floor is not None:
        parts["table"] = config.table * 1e3 * (floor - vertices[..., 2]).amax(1).relu()
    keypoints = torch.cat([joints, vertices[:, held.anatomy.tips]], 1)
    return Judged(parts, keypoints @ objects.rotations)


def _unmet(held: GraspHand, pose: GraspPose, objects: PlacedObjects, config: ForceConfig) -> Tensor:
    """(B,) share of the load that contacts cannot bear (`HeldForces`)."""
    pads = Seen.of(held, pose, objects.surface, _SOFTNESS).pads
    forces = HeldForces(pose.wrist, len(held.pads), replace(config, iterations=_FORCE_STEPS))
    return forces.unmet(pads, pose.wrist.new_zeros(1, 3), solve=True)
