"""Kinds of grasp, and for each the hand's posture at every opening: what makes synthesised grasps look human.

A template is found with the hand alone: pads of thumb and fingers face each other at a given distance (precision kinds)
or wrap a cylinder of a given diameter (power), near a relaxed posture.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import normalize

from grabnet.body.anatomy import Anatomy
from grabnet.grasping.grasp_hand import GraspHand, GraspPose
from grabnet.grasping.terms import beyond_limits


@dataclass(frozen=True)
class Kind:
    """How a kind of grasp holds.

    pads: weight of each pad's contact. thickness: metres of what it can hold. weight: how often it is tried where it
    fits, relative to the others.
    """

    pads: dict[str, float]
    thickness: tuple[float, float]
    weight: float


_FINGERTIPS = {"thumb3": 1.5, "index3": 1.0, "middle3": 1.0, "ring3": 1.0, "pinky3": 0.8}
KINDS = {
    "pinch": Kind({"thumb3": 1.5, "index3": 1.5}, (0.001, 0.025), 0.5),
    "tripod": Kind({"thumb3": 1.5, "index3": 1.2, "middle3": 1.2}, (0.002, 0.045), 1.0),
    "precision": Kind(_FINGERTIPS | {"index2": 0.15, "middle2": 0.15, "ring2": 0.15}, (0.010, 0.092), 1.0),
    "power": Kind(
        {
            "thumb3": 1.2, "thumb2": 0.5, "index3": 1.0, "middle3": 1.0, "ring3": 1.0, "pinky3": 0.8, "index2": 0.8,
            "middle2": 0.8, "ring2": 0.8, "pinky2": 0.5, "index1": 0.5, "middle1": 0.5, "ring1": 0.5,
            "palm_thenar": 0.42, "palm_mcp": 0.7, "palm_hypothenar": 0.21,
        },
        (0.014, 0.092),
        1.0,
    ),
    "lateral": Kind({"thumb3": 1.5, "index_side": 1.5}, (0.001, 0.012), 0.35),
}  # fmt: skip

# Relaxed angles per finger (MCP flexion, MCP abduction, PIP, DIP) and of the thumb (CMC × 3, MCP, IP), radians.
_RELAXED, _RELAXED_THUMB = (0.5, 0.0, 0.6, 0.35), (0.0, 0.0, 0.1, 0.2, 0.2)
_IDLE = {  # the fingers that take no part, where they don't just relax
    "tripod": {8: (0.7, 0, 0.8, 0.45), 12: (0.7, 0, 0.8, 0.45)},
    "pinch": {4: (0.6, 0, 0.7, 0.4), 8: (0.7, 0, 0.8, 0.45), 12: (0.65, 0, 0.75, 0.4)},
    "lateral": dict.fromkeys((0, 4, 8, 12), (0.9, 0, 1.1, 0.6)),
}
_TIPS = {
    "pinch": ("index3",),
    "tripod": ("index3", "middle3"),
    "precision": ("index3", "middle3", "ring3", "pinky3"),
    "lateral": ("index_side",),
}


@dataclass(frozen=True)
class TemplateConfig:
    """Lengths in metres, weights of energies that are about 1 when bad, angles in radians."""

    mcp_extension: float = -0.15  # of knuckles, the thumb's joints: further back does not look natural in a grasp
    thumb_mcp_extension: float = -0.1
    thumb_ip_extension: float = -0.3
    openings: int = 25  # from narrowest to widest, evenly
    narrowest: float = 0.004
    widest: float = 0.10
    iterations: int = 300
    learning_rate: float = 0.02  # radians
    near_relaxed: float = 0.02  # pull towards the relaxed posture
    near_wrap: float = 0.6  # the same for power, which starts from the precision template
    coupling: float = 0.1  # DIP follows PIP at `dip_per_pip`
    dip_per_pip: float = 0.6
    spread: float = 0.3  # against abduction; 2 for power
    neighbours: float = 0.05  # neighbouring fingers bend alike
    limits: float = 5.0


class Template(NamedTuple):
    """Postures at n openings, in the hand model's frame: aperture (n,) metres, angles (n, 21), centre (n, 3) of what is
    held, closing axis (n, 3) (thumb to fingers; for power along the cylinder, thumb side) and approach (n, 3)."""

    aperture: Tensor
    angles: Tensor
    centre: Tensor
    closing: Tensor
    approach: Tensor


def build_templates(hand: GraspHand, limits: Tensor, config: TemplateConfig | None = None) -> dict[str, Template]:
    """A template for each of `KINDS`, within angle limits (21, 2); a few seconds."""
    config = config or TemplateConfig()
    templates = {kind: _opposing(hand, limits, kind, config) for kind in _TIPS}
    templates["power"] = _wrapping(hand, limits, templates["precision"].angles, config)
    return {kind: templates[kind] for kind in KINDS}


def natural_limits(anatomy: Anatomy, config: TemplateConfig) -> Tensor:
    """(21, 2) radians: the anatomy's limits, narrowed to what looks natural in a grasp."""
    limits = anatomy.angle_limits.clone()
    lowest = {
        "mcp_flexion": config.mcp_extension,
        "thumb_mcp": config.thumb_mcp_extension,
        "thumb_ip": config.thumb_ip_extension,
    }
    for i, name in enumerate(anatomy.angle_names):
        for ending, value in lowest.items():
            if name.endswith(ending):
                limits[i, 0] = max(float(limits[i, 0]), value)
    return limits


def regularity(angles: Tensor, dip_per_pip: float) -> tuple[Tensor, Tensor, Tensor]:
    """How far postures (B, 21) are from a hand at ease, rad²: DIP–PIP coupling, abduction, neighbours' difference."""
    fingers = angles[:, :16].unflatten(1, (4, 4))
    coupling = (fingers[..., 3] - dip_per_pip * fingers[..., 2]).square().sum(1)
    spread = fingers[..., 1].square().sum(1)
    in_order = fingers[:, [0, 1, 3, 2]]  # index, middle, ring, pinky
    step = (in_order[:, 1:] - in_order[:, :-1]).square()
    return coupling, spread, step[..., [0, 2]].sum((1, 2)) + 2 * step[..., 1].sum(1)


def _still(hand: GraspHand, angles: Tensor) -> GraspPose:
    """Hands in the model's own frame."""
    n = len(angles)
    return GraspPose(torch.eye(3).expand(n, 3, 3), hand.joints[:1].expand(n, 3), angles)


def _palm(hand: GraspHand) -> Tensor:
    return torch.lerp(hand.joints[0], hand.joints[[1, 4, 7, 10]].mean(0), 0.55)


def _across(vector: Tensor, axis: Tensor) -> Tensor:
    """The unit part of vectors perpendicular to unit axes."""
    return normalize(vector - (vector * axis).sum(-1, keepdim=True) * axis, dim=-1)


def _opposing(hand: GraspHand, limits: Tensor, kind: str, config: TemplateConfig) -> Template:
    aperture = torch.linspace(config.narrowest, config.widest, config.openings)
    relaxed = torch.tensor([*_RELAXED * 4, *_RELAXED_THUMB])
    for start, values in _IDLE.get(kind, {}).items():
        relaxed[start : start + 4] = torch.tensor(values)
    angles = relaxed.expand(config.openings, 21).clone().requires_grad_()
    optimiser = torch.optim.Adam([angles], lr=config.learning_rate)
    pads = [hand.anatomy.pads[name] for name in ("thumb3", *_TIPS[kind])]
    sizes = [len(pad) for pad in pads]

    def contacts() -> tuple[Tensor, Tensor]:
        posed = hand.posed(_still(hand, angles), torch.cat(pads))
        normals = hand.posed_normals(posed.rotations, torch.cat(pads))
        split = (x.split(sizes, 1) for x in (posed.vertices, normals))
        points, normals = (torch.stack([pad.mean(1) for pad in x], 1) for x in split)
        return points, normalize(normals, dim=-1)

    for _ in range(config.iterations):
        points, normals = contacts()
        gap = points[:, 1:].mean(1) - points[:, 0]
        width = gap.norm(dim=-1)
        axis = (gap / width.unsqueeze(1)).unsqueeze(1)
        facing = 0.6 * (1 - (normals[:, :1] * axis).sum((1, 2))) + 0.6 * (1 + (normals[:, 1:] * axis).sum(-1)).mean(1)
        coupling, spread, neighbours = regularity(angles, config.dip_per_pip)
        beyond = beyond_limits(angles, limits)
        energy = 0.3 * ((width - aperture) * 100).square() + facing
        energy = energy + config.near_relaxed * (angles - relaxed).square().sum(1) + config.limits * beyond
        energy = energy + config.coupling * coupling + config.spread * spread
        if kind in ("precision", "lateral"):
            energy = energy + config.neighbours * neighbours
        optimiser.zero_grad()
        energy.sum().backward()
        optimiser.step()

    with torch.no_grad():
        angles = angles.clamp(*limits.T)
        points, _ = contacts()
        tips = points[:, 1:].mean(1)
        closing, centre = normalize(tips - points[:, 0], dim=-1), (tips + points[:, 0]) / 2
        approach = _across(centre - _palm(hand), closing)
    return Template((tips - points[:, 0]).norm(dim=-1), angles.detach(), centre, closing, approach)


def _wrapping(hand: GraspHand, limits: Tensor, precision: Tensor, config: TemplateConfig) -> Template:
    """Power: pads of fingers and palm on a cylinder that may move and tilt."""
    aperture = torch.linspace(config.narrowest, config.widest, config.openings)
    start = precision.clone()
    start[:, [0, 4, 8, 12]] += 0.1
    start[:, [2, 6, 10, 14]] += 0.2
    start[:, 20] = 0.1
    angles = start.clone().requires_grad_()
    distal, palmar, radial = hand.anatomy.frame
    palm = _palm(hand)
    centre = palm + 0.02 * distal + (0.02 + aperture / 2).unsqueeze(1) * palmar
    centre.requires_grad_()
    tilt = torch.zeros(config.openings, 2, requires_grad=True)
    optimiser = torch.optim.Adam(
        [
            {"params": [angles], "lr": config.learning_rate},
            {"params": [centre], "lr": 1e-3},
            {"params": [tilt], "lr": config.learning_rate},
        ]
    )
    pads = {name: pad for name, pad in hand.anatomy.pads.items() if name != "index_side"}

    def axis() -> Tensor:
        return normalize(radial + tilt[:, :1] * distal + tilt[:, 1:] * palmar, dim=-1)

    for _ in range(config.iterations):
        vertices = hand.posed(_still(hand, angles)).vertices
        offset, along = vertices - centre.unsqueeze(1), axis().unsqueeze(1)
        offset = offset - (offset * along).sum(-1, keepdim=True) * along
        distance = (offset.norm(dim=-1) - aperture.unsqueeze(1) / 2) * 1e3
        energy = 0.02 * (-distance).relu().square().sum(1)
        for name, pad in pads.items():
            near = (distance[:, pad].square() * (-distance[:, pad].abs() / 3).softmax(1)).sum(1)
            energy = energy + (0.003 if name.endswith("1") else 0.02) * near.clamp(max=400)
        coupling, spread, neighbours = regularity(angles, config.dip_per_pip)
        beyond = beyond_limits(angles, limits)
        energy = energy + config.near_wrap * (angles - start).square().sum(1) + config.limits * beyond
        energy = energy + config.coupling * coupling + 2 * spread + config.neighbours * neighbours
        energy = energy + tilt.square().sum(1) + (angles[:, 18] - 0.3).square()
        optimiser.zero_grad()
        energy.sum().backward()
        optimiser.step()

    with torch.no_grad():
        closing = axis()
        approach = _across(centre - palm, closing)
        return Template(aperture, angles.clamp(*limits.T), centre.detach(), closing, approach)
