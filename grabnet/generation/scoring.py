"""How good candidates are: what is wrong with each, in millimetres or what is as bad as so many."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from grabnet.body.hand import HandModel, HandParameters
from grabnet.contact.contacts import Contacts
from grabnet.generation.ranking import RankingConfig
from grabnet.geometry.placed import PlacedObjects
from grabnet.grasping.forces import ForceConfig, HeldForces
from grabnet.grasping.grasp_hand import GraspHand, GraspPose
from grabnet.grasping.seen import Seen
from grabnet.grasping.walls import crossing, depth_through_walls

# mm, over which a pad's contact is spread among its vertices, and steps until contact forces are found.
_SOFTNESS, _FORCE_STEPS = 1.5, 32


class Judged(NamedTuple):
    """Parts of the score, (B,) each by name, and keypoints (B, 21, 3): joints and fingertips along the object's axes,
    from its centre, metres."""

    parts: dict[str, Tensor]
    keypoints: Tensor


def judge(
    held: GraspHand,
    hand: HandModel,
    hands: HandParameters,
    rest: Tensor,
    objects: PlacedObjects,
    config: RankingConfig,
) -> Judged:
    """Judge B right hands in the world of the objects; lower parts are better.

    Args:
        held: the hand's shape.
        hand: its model.
        hands: to be judged.
        rest: (V, 3) rest vertices of the shape, metres.
        objects: B placed objects.
        config: weights.
    """
    vertices, joints = hand(hands, rest)
    distances = objects.signed_distances(vertices)
    contacts = Contacts(distances=distances, finger=held.anatomy.finger)
    pose = held.pose_of(hands)
    posed = held.posed(pose)
    bones = 1e3 * (config.bone_share * held.radii - objects.signed_distances(posed.spheres)).amax(1)
    through = depth_through_walls(objects.signed_distances, held, posed).amax(1)
    fingers = (contacts.contact_vertices[:, :5] > 0).sum(1)
    parts = {
        "depth": config.depth * (1e3 * contacts.max_penetration - config.depth_free).relu(),
        "through": config.through * (through - config.through_free).relu(),
        "bone": config.bone * bones.relu(),
        "crossing": config.crossing * crossing(held, posed).relu(),
        "unheld": config.unheld * (~contacts.pinched).float(),
        "force": config.force * _unmet(held, pose, objects),
        "fingers": -config.finger * fingers.float(),
    }
    keypoints = torch.cat([joints, vertices[:, held.anatomy.tips]], 1)
    return Judged(parts, keypoints @ objects.rotations)


def _unmet(held: GraspHand, pose: GraspPose, objects: PlacedObjects) -> Tensor:
    """(B,) share of the load that contacts cannot bear (`HeldForces`)."""
    pads = Seen.of(held, pose, objects.surface, _SOFTNESS).pads
    forces = HeldForces(pose.wrist, len(held.pads), ForceConfig(iterations=_FORCE_STEPS))
    return forces.unmet(pads, pose.wrist.new_zeros(1, 3), solve=True)
