"""The optimiser of sampled grasps: a hand that a network drew, moved to where it holds and goes through no wall."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import torch
from torch import Tensor

from grabnet.geometry.atlas import SDFAtlas
from grabnet.grasping import terms
from grabnet.grasping.descent import DescentConfig, descend
from grabnet.grasping.forces import ForceConfig, HeldForces
from grabnet.grasping.grasp_hand import FOREARM_RADIUS, GraspHand, GraspPose
from grabnet.grasping.terms import Pads


class Surface(Protocol):
    """An object's surface: signed distances (B, N), metres, and unit normals (B, N, 3) of points (B, N, 3) in its frame."""

    def __call__(self, points: Tensor) -> tuple[Tensor, Tensor]: ...


class AtlasSurface:
    """The surface of one object of an atlas."""

    def __init__(self, atlas: SDFAtlas, index: int = 0):
        self.atlas, self.index = atlas, index

    def __call__(self, points: Tensor) -> tuple[Tensor, Tensor]:
        objects = torch.full((len(points),), self.index, dtype=torch.int64, device=points.device)
        return self.atlas.with_gradient(points, objects)


@dataclass(frozen=True)
class OptimiserConfig(DescentConfig):
    """Descent, and the weights of the energy's terms; lengths in millimetres."""

    contact: float = 1.0  # per mm of a pad's distance
    contact_target: float = -0.7  # pads sink in a little: skin yields
    furthest: float = 40.0  # a pad further away than this no longer pulls
    near: float = 12.0  # over which a pad's share fades with its distance at the start
    skin: float = 0.3  # per mm² of skin inside the object
    skin_slack: float = 0.8
    spheres: float = 1.0  # per mm² of overlap of the spheres in the fingers: this keeps them out of thin walls
    sphere_share: float = 0.9  # of a sphere's radius
    forearm: float = 0.02  # per mm² by which the object is nearer to the forearm than …
    forearm_gap: float = 5.0
    table: float = 0.4  # per mm² of skin or forearm below the table, where there is one
    table_gap: float = 1.0
    self_overlap: float = 1.0  # per mm² of overlap between fingers
    alignment: float = 3.0  # pads face the surface they touch
    opposition: float = 3.0  # thumb and fingers press against each other
    force: float = 20.0  # per squared share of the load that contacts leave
    posture: float = 2.0  # per rad² of an angle from the start
    wrist: float = 0.5  # per square of the wrist's way from the start, in units of `wrist_scale`
    wrist_scale: float = 20.0
    turn: float = 5.5  # per rad² from the start (2 − 2 cosine)
    forces: ForceConfig = field(default_factory=ForceConfig)
    force_every: int = 4  # iterations between looks at the contact forces


# Which pads a grasp uses most: of fingertips all, of the other phalanges half.
_PAD_WEIGHT = {"1": 0.5, "2": 0.5, "3": 1.0}
_PALM_WEIGHT = 0.3


class GraspOptimiser:
    """Moves hands of one shape to where they hold an object.

    Args:
        hand: the hand's shape.
        likelihood: (V,) how often each vertex of the hand touches, in people's grasps, at most 1; pads count by it.
            When omitted, fingertips count most.
    """

    def __init__(self, hand: GraspHand, config: OptimiserConfig, likelihood: Tensor | None = None):
        self.hand, self.config = hand, config
        if likelihood is None:
            weights = [_PAD_WEIGHT.get(name[-1], _PALM_WEIGHT) for name in hand.pad_names]
            self.pad_weight = hand.rest.new_tensor(weights)
        else:
            on_pads = likelihood.to(hand.rest)[hand.sample[hand.pads]] * hand.pad_mask
            self.pad_weight = on_pads.sum(1) / hand.pad_mask.sum(1) / on_pads.max()

    def __call__(
        self, start: GraspPose, surface: Surface, centre: Tensor | None = None, floor: float | None = None
    ) -> GraspPose:
        """Grasps (B) near the starts (B), in the object's frame, on its device.

        Args:
            centre: (3,) metres, the object's centre of mass, where gravity pulls; when omitted, the middle of the pads
                that touch at the start.
            floor: height (z) of the table in metres; when omitted, there is none.
        """
        if not (self.config.iterations and len(start.wrist)):
            return start
        energy = GraspEnergy(self, start, surface, centre, floor)
        return descend(start, energy, self.hand.anatomy.angle_limits, self.config)


class GraspEnergy:
    """Energy of a batch of hands, which started at given poses, on one object."""

    def __init__(
        self,
        optimiser: GraspOptimiser,
        start: GraspPose,
        surface: Surface,
        centre: Tensor | None = None,
        floor: float | None = None,
    ):
        self.hand, self.config, self.surface = optimiser.hand, optimiser.config, surface
        self.start, self.floor = start, floor
        hand, c = self.hand, self.config
        self._skin_reach = torch.where(hand.sampled_once, -c.skin_slack, -1e4)
        self._inner_reach = torch.cat(
            [
                c.sphere_share * 1e3 * hand.radii,
                hand.radii.new_full((hand.n_forearm,), 1e3 * FOREARM_RADIUS + c.forearm_gap),
            ]
        )
        self._thumb = hand.pad_names.index("thumb3")
        with torch.no_grad():
            pads, _ = self._look(start, c.softness[0])[1:]
            self.weight, self._finger_share = self._meant(optimiser.pad_weight, pads)
            middle = (self.weight.unsqueeze(-1) * pads.place).sum(1) / self.weight.sum(1, keepdim=True)
        self._centre = middle if centre is None else centre.to(middle).expand_as(middle)
        self._forces = HeldForces(start.wrist, len(hand.pads), c.forces)

    def _meant(self, pad_weight: Tensor, pads: Pads) -> tuple[Tensor, Tensor]:
        """Weights (B, P) of the pads' contact: those near at the start, the thumb's tip and the nearest fingertip;
        and the shares (B, P) of those that oppose the thumb."""
        near = (pads.share * pads.gap).sum(-1).relu()
        weight = pad_weight * torch.exp(-near / self.config.near)
        tips = torch.tensor([n[-1] == "3" and n != "thumb3" for n in self.hand.pad_names]).to(near.device)
        nearest = torch.where(tips, near, torch.inf).argmin(1, keepdim=True)
        needed = torch.zeros_like(weight).scatter(1, nearest, 1.0)
        needed[:, self._thumb] = 1
        weight = torch.maximum(weight, needed)
        fingers = weight * ~self.hand.of_thumb
        return weight, fingers / fingers.sum(1, keepdim=True)

    def _look(self, pose: GraspPose, softness: float):
        hand = self.hand
        points, sampled = hand.sampled(pose)
        distance, normal = self.surface(points)
        distance = 1e3 * distance
        return distance, Pads.of(hand, sampled, distance, normal, softness), sampled

    def __call__(self, pose: GraspPose, softness: float, firmness: float, iteration: int) -> Tensor:
        """(B,) energies.

        Args:
            softness: mm, over which a pad's contact is spread among its vertices; low: only the nearest counts.
            firmness: factor on all overlap with object and table.
            iteration: number of the look; every few, forces are solved for.
        """
        c, hand = self.config, self.hand
        distance, pads, sampled = self._look(pose, softness)
        sizes = [len(hand.sample), len(hand.radii), hand.n_forearm]
        skin, spheres, forearm = distance.split(sizes, 1)
        sphere_reach, forearm_reach = self._inner_reach.split(sizes[1:])
        through = c.skin * terms.overlap(skin, self._skin_reach) + c.spheres * terms.overlap(spheres, sphere_reach)
        if c.forearm:
            through = through + c.forearm * terms.overlap(forearm, forearm_reach, 40)
        if self.floor is not None:
            skin = 1e3 * (sampled.skin[..., 2] - self.floor)
            forearm = 1e3 * (sampled.forearm[..., 2] - self.floor)
            below = terms.below_table(skin, c.table_gap)
            through = through + c.table * (below + terms.below_table(forearm, 1e3 * FOREARM_RADIUS + c.table_gap))
        energy = firmness * through
        energy = energy + c.contact * terms.contact(pads, self.weight, c.contact_target, c.furthest)
        if c.alignment:
            energy = energy + c.alignment * terms.alignment(pads, self.weight)
        if c.opposition:
            energy = energy + c.opposition * terms.opposition(pads, self._thumb, self._finger_share)
        if c.force:
            solve = iteration % c.force_every == 0
            energy = energy + c.force * self._forces.unmet(pads, self._centre, solve)
        if c.self_overlap:
            energy = energy + c.self_overlap * hand.overlap(sampled.spheres)
        start = self.start
        energy = energy + c.posture * terms.strayed(pose.angles, start.angles)
        energy = energy + c.wrist * terms.strayed(1e3 * pose.wrist, 1e3 * start.wrist, c.wrist_scale)
        return energy + c.turn / 2 * terms.strayed(pose.rotation.flatten(1), start.rotation.flatten(1))
