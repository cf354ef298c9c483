"""The optimiser of sampled grasps: a hand that a network drew, moved to where it holds and goes through no wall."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import torch
from torch import Tensor

from grabnet.cli.checks import Count, Positive, Range, Weight
from grabnet.grasping import terms
from grabnet.grasping.descent import DescentConfig, descend
from grabnet.grasping.forces import ForceConfig, HeldForces
from grabnet.grasping.grasp_hand import GraspHand, GraspPose
from grabnet.grasping.obstacles import ObstacleConfig, Obstacles
from grabnet.grasping.seen import Pads, Seen
from grabnet.grasping.surface import Surface
from grabnet.precision import full_precision


@dataclass(frozen=True)
class OptimiserConfig(DescentConfig, ObstacleConfig):
    """Descent, and the weights of the energy's terms; lengths in millimetres."""

    contact: Weight = 2.0  # per mm of a pad's distance
    contact_target: Annotated[float, Range()] = -0.7  # pads sink in a little: skin yields
    furthest: Positive = 1000.0  # a pad further away than this no longer pulls
    phalanges: Weight = 1.0  # share of the pads of proximal and middle phalanges, fingertips having 1
    palm: Weight = 0.6  # share of the palm's pads and of the index finger's side
    near: Positive = 30.0  # over which a pad's share fades with its distance at the start
    skin_slack: Weight = 0.8
    self_overlap: Weight = 1.0  # per mm² of overlap between fingers
    alignment: Weight = 3.0  # pads face the surface they touch
    opposition: Weight = 3.0  # thumb and fingers press against each other
    force: Weight = 10.0  # per squared share of the load that contacts leave
    knuckle_flexion: Positive = 1.2  # radians at most, of fingers: beyond that the skin folds into itself
    posture: Weight = 2.0  # per rad² of an angle from the start
    wrist: Weight = 0.5  # per square of the wrist's way from the start, in units of `wrist_scale`
    wrist_scale: Positive = 20.0
    turn: Weight = 5.5  # per rad² from the start (2 − 2 cosine)
    forces: ForceConfig = field(default_factory=ForceConfig)
    force_every: Count = 4  # iterations between looks at the contact forces


class GraspOptimiser:
    """Moves hands of one shape to where they hold an object.

    Args:
        hand: the hand's shape.
        config: weights, rates and what is ramped.
    """

    def __init__(self, hand: GraspHand, config: OptimiserConfig):
        self.hand, self.config = hand, config
        self.limits = hand.anatomy.angle_limits.clone()
        knuckles = [name.endswith("mcp_flexion") for name in hand.anatomy.angle_names]
        self.limits[torch.tensor(knuckles, device=self.limits.device), 1] = config.knuckle_flexion
        share = {"1": config.phalanges, "2": config.phalanges, "3": 1.0}
        self.pad_weight = hand.rest.new_tensor([share.get(name[-1], config.palm) for name in hand.pad_names])

    @full_precision
    def __call__(
        self, start: GraspPose, surface: Surface, centre: Tensor | None = None, floor: float | None = None
    ) -> GraspPose:
        """Grasps (B) near the starts (B), in the object's frame, on its device.

        Args:
            centre: (3,) or (B, 3) metres, the object's centre of mass, where gravity pulls; when omitted, the middle of
                the pads that are near at the start.
            floor: height (z) of the table in metres; when omitted, there is none.
        """
        if not (self.config.iterations and len(start.wrist)):
            return start
        start = start._replace(angles=start.angles.clamp(*self.hand.anatomy.angle_limits.T))
        energy = HoldingEnergy(self.hand, self.config, self.pad_weight, start, surface, centre, floor)
        return descend(start, self.hand.anatomy.frame, energy, self.limits, self.config)


class HoldingEnergy:
    """Energy of a batch of hands on one object, B of them, which started at given poses.

    Args:
        pad_weight: (P,) how much each pad counts.
        centre, floor: as in `GraspOptimiser`.
    """

    def __init__(
        self,
        hand: GraspHand,
        config: OptimiserConfig,
        pad_weight: Tensor,
        start: GraspPose,
        surface: Surface,
        centre: Tensor | None = None,
        floor: float | None = None,
    ):
        self.hand, self.config, self.start, self.surface = hand, config, start, surface
        self.obstacles = Obstacles(hand, config, floor)
        self._thumb = hand.pad_names.index("thumb3")
        with torch.no_grad():
            pads = Seen.of(hand, start, surface, config.softness[0]).pads
        self.weight, self._opposing = self._meant(pad_weight, pads)
        middle = (self.weight.unsqueeze(-1) * pads.place).sum(1) / self.weight.sum(1, keepdim=True)
        self._centre = middle if centre is None else centre.to(middle).expand_as(middle)
        self._forces = HeldForces(start.wrist, len(hand.pads), config.forces)

    def _meant(self, pad_weight: Tensor, pads: Pads) -> tuple[Tensor, Tensor]:
        """(B, P) weights of the pads that are meant to touch, and of those the shares that oppose the thumb.

        Those near the object at the start; the thumb's tip and the fingertip nearest to the object in any case.
        """
        near = pads.distance.relu()
        weight = pad_weight * torch.exp(-near / self.config.near)
        names = self.hand.pad_names
        tips = torch.tensor([name[-1] == "3" and name != "thumb3" for name in names], device=near.device)
        nearest = torch.where(tips, near, torch.inf).argmin(1, keepdim=True)
        needed = torch.zeros_like(weight).scatter(1, nearest, 1.0)
        needed[:, self._thumb] = 1
        weight = torch.maximum(weight, needed)
        fingers = weight * ~self.hand.of_thumb
        return weight, fingers / fingers.sum(1, keepdim=True)

    def __call__(self, pose: GraspPose, softness: float, firmness: float, iteration: int) -> Tensor:
        """(B,) energies.

        Args:
            softness: mm, over which a pad's contact is spread among its vertices; low: only the deepest counts.
            firmness: factor on all overlap with object and table.
            iteration: number of the look; at every few of them forces are solved for.
        """
        c, start = self.config, self.start
        seen = Seen.of(self.hand, pose, self.surface, softness)
        energy = firmness * self.obstacles(seen)
        energy = energy + c.contact * terms.contact(seen.pads, self.weight, c.contact_target, c.furthest)
        energy = energy + c.alignment * terms.alignment(seen.pads, self.weight)
        energy = energy + c.opposition * terms.opposition(seen.pads, self._thumb, self._opposing)
        energy = energy + c.self_overlap * self.hand.self_overlap(seen.sampled.spheres)
        if c.force:
            solve = iteration % c.force_every == 0
            energy = energy + c.force * self._forces.unmet(seen.pads, self._centre, solve)
        energy = energy + c.posture * terms.strayed(pose.angles, start.angles)
        energy = energy + c.wrist * terms.strayed(1e3 * pose.wrist, 1e3 * start.wrist, c.wrist_scale)
        return energy + c.turn / 2 * terms.strayed(pose.rotation.flatten(1), start.rotation.flatten(1))
