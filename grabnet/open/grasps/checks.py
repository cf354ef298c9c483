"""Which optimised grasps a human hand could hold: contact, overlap, thin walls, crossed fingers, posture."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import normalize

from grabnet.body.anatomy import FINGERS
from grabnet.grasping.grasp_hand import FOREARM_RADIUS, GraspHand, GraspPose
from grabnet.grasping.proposing.grasped_object import GraspedObject
from grabnet.grasping.proposing.posture import PostureConfig, discomfort
from grabnet.grasping.proposing.proposals import Proposals
from grabnet.grasping.walls import crossing, depth_through_walls


@dataclass(frozen=True)
class AcceptanceConfig:
    """Bounds of what is accepted; lengths in millimetres."""

    touching: float = 3.0  # a vertex this near the surface is in contact
    vertices_per_finger: int = 2  # a finger is in contact with so many vertices
    max_depth: float = 4.0  # of any vertex inside the object
    mean_depth: float = 2.0  # over the vertices inside
    through: float = 3.5  # from where the line from a bone to its skin enters the object, to the skin: thin walls
    bone_share: float = 0.45  # of its sphere's radius, by which a bone may be short of clear …
    bone_depth: float = 2.5  # … by at most so much
    crossing: float = 2.5  # of one finger in another
    forearm: float = 8.0
    below_table: float = 1.0
    opposed: float = -0.2  # cosine between the surface normals under the thumb and under what opposes it
    uneasy: float = 0.08  # discomfort
    off_part: float = 12.0  # of the middle of the contacts outside the part that was meant
    bend: float = 0.75  # radians by which neighbouring fingers may differ at knuckle or middle joint


class GraspMeasures(NamedTuple):
    """Of B grasps; lengths in millimetres, negative distances inside.

    distance (B, V); contacts (B, 6) vertices in contact of each of FINGERS, then the palm; max_depth, mean_depth,
    through, bone_depth, crossing, forearm, below_table, opposed, uneasy, off_part (B,); bend (B,) radians.
    """

    distance: Tensor
    contacts: Tensor
    max_depth: Tensor
    mean_depth: Tensor
    through: Tensor
    bone_depth: Tensor
    crossing: Tensor
    forearm: Tensor
    below_table: Tensor
    opposed: Tensor
    uneasy: Tensor
    off_part: Tensor
    bend: Tensor


def measure(
    scene: GraspedObject,
    hand: GraspHand,
    pose: GraspPose,
    proposals: Proposals,
    config: AcceptanceConfig,
    posture: PostureConfig,
) -> GraspMeasures:
    """Measure grasps against what they were meant to be."""
    posed = hand.posed(pose)
    distance, normal = (x.clone() for x in scene.distance_and_normal(posed.vertices))
    distance = distance * 1e3
    touching = distance < config.touching
    part_of_vertex = hand.anatomy.finger.remainder(len(FINGERS) + 1)  # palm and wrist last
    members = torch.nn.functional.one_hot(part_of_vertex, len(FINGERS) + 1).float()
    contacts = touching.float() @ members

    depth = (-distance).relu()
    spheres, forearm = scene.distance(posed.spheres) * 1e3, scene.distance(posed.forearm) * 1e3
    centre = (posed.vertices * touching.unsqueeze(-1)).sum(1) / touching.sum(1, keepdim=True).clamp_min(1)
    low = torch.stack([part.low for part in scene.parts])[proposals.part]
    high = torch.stack([part.high for part in scene.parts])[proposals.part]
    under = torch.cat(
        [scene.floor - posed.vertices[..., 2], scene.floor + 0.7 * FOREARM_RADIUS - posed.forearm[..., 2]], 1
    )

    surface = torch.einsum("bv,bvc,vp->bpc", touching.float(), normal, members)
    surface = normalize(surface, dim=-1) * (contacts >= config.vertices_per_finger).unsqueeze(-1)
    opposed = (surface[:, :1] * surface[:, 1:]).sum(-1).amin(1)

    flexion = pose.angles[:, :16].unflatten(1, (4, 4))[:, [0, 1, 3, 2]][..., [0, 2]]
    return GraspMeasures(
        distance=distance,
        contacts=contacts.long(),
        max_depth=depth.amax(1),
        mean_depth=depth.sum(1) / (depth > 0).sum(1).clamp_min(1),
        through=depth_through_walls(scene.distance, hand, posed).amax(1),
        bone_depth=(config.bone_share * hand.radii * 1e3 - spheres).amax(1),
        crossing=crossing(hand, posed),
        forearm=(FOREARM_RADIUS * 1e3 - config.forearm - forearm).amax(1),
        below_table=under.amax(1) * 1e3,
        opposed=opposed,
        uneasy=discomfort(pose.rotation, hand.anatomy.frame, proposals.on_table, proposals.forward, posture),
        off_part=torch.maximum(low - centre, centre - high).relu().norm(dim=1) * 1e3,
        bend=(flexion[:, 1:] - flexion[:, :-1]).abs().amax((1, 2)),
    )


def verdicts(measures: GraspMeasures, on_table: Tensor, config: AcceptanceConfig) -> dict[str, Tensor]:
    """(B,) bool for each condition: what a grasp must pass, all of them, to be accepted."""
    m = measures
    finger = m.contacts[:, :5] >= config.vertices_per_finger
    bounded = {f.name for f in fields(config)} & set(GraspMeasures._fields) - {"below_table", "opposed", "forearm"}
    return {
        "thumb": finger[:, 0],
        "finger": finger[:, 1:].any(1),
        "forearm": m.forearm <= 0.1,
        "table": ~on_table | (m.below_table <= config.below_table),
        "opposed": m.opposed <= config.opposed,
    } | {name: getattr(m, name) <= getattr(config, name) for name in sorted(bounded)}
