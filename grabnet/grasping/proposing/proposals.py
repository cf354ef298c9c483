"""Where to start: templates put at the object's surface, the best of several by a cheap score."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import normalize

from grabnet.grasping.grasp_hand import FOREARM_RADIUS, GraspHand, GraspPose
from grabnet.grasping.proposing.grasped_object import GraspedObject, Part
from grabnet.grasping.proposing.posture import PostureConfig, discomfort
from grabnet.grasping.proposing.templates import KINDS, Template

KIND_NAMES = tuple(KINDS)
_POWER = KIND_NAMES.index("power")


@dataclass(frozen=True)
class ProposalConfig:
    """Lengths in metres."""

    per_slot: int = 8  # candidates of one kind on one part, of which the best is taken
    spare: float = 1.25  # slots made per one that is asked for; the worst are dropped
    on_table: float = 0.5  # share that must clear the table
    reach: float = 0.10  # thickness is sought up to this deep
    full_width: float = 0.9  # share that spans the whole object, not its nearest wall
    steep: float = 0.6  # height of the normals that are not gripped there, from above and below
    opening: float = 0.018  # template aperture beyond the thickness: skin is not at the pads' middle
    power_opening: float = 0.055  # narrowest template of power that is used; fingers close by optimisation
    power_on_slender: float = 3.0  # power is so much likelier on handles
    pinch_on_slender: float = 0.4
    room: float = 0.045  # height above the table below which power is not tried there
    vertical: float = 0.6  # share of power grasps about the vertical, on parts that are not slender
    along: float = 0.8  # share of precision grasps with fingertips in line along a slender part
    turn: float = 0.15  # spread of directions, about radians
    shift: float = 0.003  # spread of positions
    draw_back: float = 0.02  # at most this far back along the approach
    uneasy: float = 1e4  # score of 1 of discomfort; scores are mm² of overlap and mm of distance
    worst: float = 5e3  # slots with no better score are given up


class Proposals(NamedTuple):
    """B starts: poses, kind (B,) indices into KINDS, part (B,) indices, on_table (B,) bool, forward (B, 3)."""

    pose: GraspPose
    kind: Tensor
    part: Tensor
    on_table: Tensor
    forward: Tensor

    def select(self, index: Tensor) -> Proposals:
        """The chosen batch elements."""
        return Proposals(self.pose.select(index), *(x[index] for x in self[1:]))


def propose(
    scene: GraspedObject,
    hand: GraspHand,
    templates: dict[str, Template],
    n: int,
    generator: torch.Generator,
    config: ProposalConfig,
    posture: PostureConfig,
) -> Proposals:
    """At most n starts."""
    slots, each = int(n * config.spare), config.per_slot
    rows = slots * each

    def rand(*size: int) -> Tensor:
        return torch.rand(*size, generator=generator)

    def near(vector: Tensor) -> Tensor:
        return normalize(vector + config.turn * torch.randn(vector.shape, generator=generator), dim=-1)

    part = torch.multinomial(torch.tensor([p.weight for p in scene.parts]), slots, True, generator=generator)
    part = part.repeat_interleave(each)
    on_table = (rand(slots) < config.on_table).repeat_interleave(each)
    slender = torch.tensor([p.slender for p in scene.parts])[part]
    forward = torch.stack([p.forward for p in scene.parts])[part]
    long_axis = torch.stack([p.axis for p in scene.parts])[part]
    point, normal = torch.empty(rows, 3), torch.empty(rows, 3)
    for i, p in enumerate(scene.parts):
        here = part == i
        chosen = torch.multinomial(_evenly(p), int(here.sum()), True, generator=generator) if here.any() else []
        point[here], normal[here] = p.points[chosen], p.normals[chosen]

    thickness = scene.thickness(point, -normal, rand(rows) < config.full_width, config.reach)
    tangent = _perpendicular(torch.randn(rows, 3, generator=generator), normal)
    up = torch.tensor([0.0, 0.0, 1.0]).expand(rows, 3)
    sign = torch.where(rand(rows, 1) < 0.5, -1.0, 1.0)
    sign = torch.where(forward.square().sum(1, keepdim=True) > 0, 1.0, sign)  # long_axis points forward
    wrapped = torch.where((rand(rows, 1) < config.vertical), up, tangent)
    wrapped = _perpendicular(torch.where(slender.unsqueeze(1), sign * long_axis, wrapped) + 0.05 * tangent, normal)
    # Of what power would close around: the width across the axis, through the middle of the thickness.
    middle = point - normal * thickness.unsqueeze(1) / 2
    across = normalize(torch.linalg.cross(normal, wrapped), dim=-1)
    everywhere = torch.ones(rows, dtype=torch.bool)
    width = sum(scene.thickness(middle, side * across, everywhere, config.reach) for side in (1, -1))
    girth = torch.maximum(width, thickness)

    # A fist around something needs room between it and the table.
    cramped = on_table & (middle[:, 2] - scene.floor < config.room)
    kind = _kinds(*(x[::each] for x in (thickness, girth, slender, cramped)), generator, config)
    kind = kind.repeat_interleave(each)
    power = (kind == _POWER).unsqueeze(1)
    size = torch.where(power.squeeze(1), girth, thickness)
    fits = torch.tensor([k.thickness for k in KINDS.values()])[kind]
    misfit = (size < fits[:, 0]) | (size > fits[:, 1])
    # Nor is there room for a fingertip under what lies on the table.
    misfit |= cramped & (normal[:, 2].abs() > config.steep)

    in_line = (slender & (rand(rows) < config.along)).unsqueeze(1)
    tangent = torch.where(
        in_line, normalize(sign * torch.linalg.cross(normal, long_axis) + 1e-3 * tangent, dim=-1), tangent
    )
    closing = near(torch.where(power, wrapped, -normal))
    approach = _perpendicular(near(torch.where(power, -normal, tangent)), closing)
    target = _frame(closing, approach)
    rotation, wrist, angles = torch.empty(rows, 3, 3), torch.empty(rows, 3), torch.empty(rows, 21)
    for k, name in enumerate(KIND_NAMES):
        here, template = kind == k, templates[name]
        aperture = size[here] + config.opening
        aperture = aperture.clamp_min(config.power_opening) if k == _POWER else aperture
        i = (aperture.unsqueeze(1) - template.aperture).abs().argmin(1)
        turn = target[here] @ _frame(template.closing, template.approach)[i].mT
        centre = middle[here]
        if k == _POWER:  # the palm touches at the point
            centre = point[here] - normal[here] * template.aperture[i].unsqueeze(1) / 2
        rotation[here], angles[here] = turn, template.angles[i]
        wrist[here] = centre - (turn @ (template.centre[i] - hand.joints[0]).unsqueeze(-1)).squeeze(-1)
    wrist = wrist - config.draw_back * rand(rows, 1) * approach
    wrist = wrist + config.shift * torch.randn(rows, 3, generator=generator)
    candidates = Proposals(GraspPose(rotation, wrist, angles), kind, part, on_table, forward)

    score = _score(scene, hand, candidates) + 1e5 * misfit
    score = score + config.uneasy * discomfort(rotation, hand.anatomy.frame, on_table, forward, posture)
    best, winner = score.unflatten(0, (slots, each)).min(1)
    rows = torch.arange(slots) * each + winner
    kept = torch.where(best < config.worst)[0]
    # The worst go, but those left stay in the order drawn: all are equally random.
    kept = kept[best[kept].argsort()[:n]].sort().values
    return candidates.select(rows[kept])


def _evenly(part: Part) -> Tensor:
    """(N,) chances of a part's points: half by area, half evenly along its axis, so that thin ends get their share."""
    along = part.points @ part.axis
    low, high = along.aminmax()
    bins = ((along - low) / (high - low + 1e-9) * 14).long().clamp(max=13)
    weight = 1 / bins.bincount(minlength=14)[bins]
    return 1 / len(along) + weight / weight.sum()


def _kinds(
    thickness: Tensor,
    girth: Tensor,
    slender: Tensor,
    cramped: Tensor,
    generator: torch.Generator,
    config: ProposalConfig,
) -> Tensor:
    weight = torch.empty(len(thickness), len(KINDS))
    for k, kind in enumerate(KINDS.values()):
        size = girth if k == _POWER else thickness
        fits = (torch.minimum(size, thickness) >= kind.thickness[0]) & (size <= kind.thickness[1])
        fits &= ~(cramped & (k == _POWER))
        factor = config.power_on_slender if k == _POWER else config.pinch_on_slender if k < 1 else 1.0
        weight[:, k] = kind.weight * fits * torch.where(slender, factor, 1.0) + 1e-9
    return torch.multinomial(weight, 1, generator=generator).squeeze(1)


def _score(scene: GraspedObject, hand: GraspHand, candidates: Proposals) -> Tensor:
    """(N,) overlap with object and table in mm² and distance of the pads in mm, weighted as they matter."""
    pads = hand.pads[torch.arange(len(hand.pads)), hand.pad_mask.sum(1) // 2]
    some = torch.cat([hand.sample[pads], torch.arange(0, len(hand.rest), 6)])
    with torch.no_grad():
        posed = hand.posed(candidates.pose, some)
        inner = torch.cat([posed.spheres, posed.forearm], 1)
        radii = torch.cat([hand.radii, torch.full((posed.forearm.shape[1],), FOREARM_RADIUS)])
        skin, inside = scene.distance(posed.vertices) * 1e3, scene.distance(inner) * 1e3
        under = (scene.floor + radii - inner[..., 2]).relu() * 1e3
        overlap = 0.1 * (-skin[:, len(pads) :]).relu().square().sum(1)
        overlap = overlap + 0.02 * (radii * 1e3 - inside).clamp(0, 40).square().sum(1)
        overlap = overlap + candidates.on_table * 0.02 * under.clamp(max=40).square().sum(1)
        return overlap + 0.5 * (pad_weights(hand)[candidates.kind] * skin[:, : len(pads)].abs().clamp(max=60)).sum(1)


def pad_weights(hand: GraspHand) -> Tensor:
    """(kinds, pads) weight of each pad's contact."""
    return torch.tensor([[kind.pads.get(name, 0.0) for name in hand.pad_names] for kind in KINDS.values()])


def _perpendicular(vector: Tensor, axis: Tensor) -> Tensor:
    return normalize(vector - (vector * axis).sum(-1, keepdim=True) * axis, dim=-1)


def _frame(closing: Tensor, approach: Tensor) -> Tensor:
    return torch.stack([closing, approach, torch.linalg.cross(closing, approach)], -1)
