"""What a good grasp minimises, in millimetres and cosines: pads touch, nothing overlaps, the hand stays at ease."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import normalize

from grabnet.grasping.grasp_hand import FOREARM_RADIUS, GraspHand, GraspPose, Posed
from grabnet.grasping.spheres import overlaps
from grabnet.open.grasps.posture import PostureConfig, discomfort
from grabnet.open.grasps.proposals import Proposals, pad_weights
from grabnet.open.grasps.scene import SynthesisScene
from grabnet.open.grasps.templates import regularity


@dataclass(frozen=True)
class EnergyConfig:
    """Weights (ref. 15), and lengths in millimetres."""

    contact: float = 1.0  # per mm of a pad's distance
    contact_target: float = -0.6  # pads sink in a little: skin yields
    furthest: float = 40.0  # a pad further away than this no longer pulls
    skin: float = 0.3  # per mm² of skin inside the object
    skin_slack: float = 1.0
    spheres: float = 1.0  # per mm² of overlap of the spheres in the fingers: this keeps them out of thin walls
    sphere_share: float = 0.9  # of a sphere's radius
    forearm: float = 0.02
    forearm_gap: float = 5.0
    table: float = 0.4  # per mm² of skin or forearm below the table
    table_gap: float = 1.0
    self_overlap: float = 1.0  # per mm² of overlap between fingers
    alignment: float = 4.0  # pads face the surface they touch
    opposition: float = 8.0  # thumb and fingers press against each other
    power_opposition: float = 0.3  # share of that in a power grasp, where the palm helps
    prior: float = 1.2  # per rad² from the template
    limits: float = 200.0
    coupling: float = 2.0  # DIP = dip_per_pip × PIP
    dip_per_pip: float = 0.6
    spread: float = 4.0
    neighbours: float = 1.5
    posture: float = 30.0  # per unit of discomfort


class GraspEnergy:
    """Energy of a batch of grasps of one subject on one object.

    Args:
        scene, hand: object and subject.
        proposals: kinds, table flags and directions of the batch.
        prior: (B, 21) angles that the posture is drawn to.
        limits: (21, 2) radians.
    """

    def __init__(
        self,
        scene: SynthesisScene,
        hand: GraspHand,
        proposals: Proposals,
        prior: Tensor,
        limits: Tensor,
        config: EnergyConfig,
        posture: PostureConfig,
    ):
        self.scene, self.hand, self.proposals, self.prior = scene, hand, proposals, prior
        self.limits, self.config, self.posture = limits, config, posture
        self.pad_weight = pad_weights(hand)[proposals.kind]
        thumb = hand.pad_names.index("thumb3")
        fingers = self.pad_weight.clone()
        fingers[:, thumb] = 0
        self._thumb, self._finger_share = thumb, fingers / fingers.sum(1, keepdim=True)
        palm_helps = self.pad_weight[:, hand.pad_names.index("palm_mcp")] > 0
        self._opposed = torch.where(palm_helps, config.power_opposition, 1.0)

    def __call__(self, pose: GraspPose, softness: float, firmness: float) -> Tensor:
        """(B,) energies.

        Args:
            softness: mm, over which a pad's contact is spread among its vertices; low: only the nearest counts.
            firmness: factor on all overlap, raised as the optimisation proceeds.
        """
        c, hand = self.config, self.hand
        posed = hand.posed(pose, hand.sample)
        inner = torch.cat([posed.spheres, posed.forearm], 1)
        distance, normal = self.scene.distance_and_normal(torch.cat([posed.vertices, inner], 1))
        skin, spheres, forearm = (distance * 1e3).split([len(hand.sample), len(hand.radii), posed.forearm.shape[1]], 1)

        overlap = c.skin * (-skin - c.skin_slack).clamp(0, 25).square().sum(1)
        overlap = overlap + c.spheres * (c.sphere_share * hand.radii * 1e3 - spheres).clamp(0, 25).square().sum(1)
        overlap = overlap + c.forearm * (FOREARM_RADIUS * 1e3 + c.forearm_gap - forearm).clamp(0, 40).square().sum(1)
        overlap = overlap + self.proposals.on_table * c.table * self._below(posed)
        energy = firmness * overlap + c.self_overlap * self._self_overlap(posed.spheres)
        energy = energy + self._touch(posed, skin, normal, softness)

        coupling, spread, neighbours, beyond = regularity(pose.angles, self.limits, c.dip_per_pip)
        energy = energy + c.coupling * coupling + c.spread * spread + c.neighbours * neighbours + c.limits * beyond
        energy = energy + c.prior * (pose.angles - self.prior).square().sum(1)
        uneasy = discomfort(pose.rotation, self.proposals.on_table, self.proposals.forward, self.posture)
        return energy + c.posture * uneasy

    def _below(self, posed: Posed) -> Tensor:
        """mm² of skin and forearm under the table."""
        floor = self.scene.floor + self.config.table_gap * 1e-3
        skin = (floor - posed.vertices[..., 2]).relu()
        forearm = (floor + FOREARM_RADIUS - posed.forearm[..., 2]).relu()
        return 1e6 * (skin.square().sum(1) + forearm.square().sum(1))

    def _self_overlap(self, spheres: Tensor) -> Tensor:
        return 0.5 * overlaps(spheres, self.hand.apart).square().sum((1, 2))

    def _touch(self, posed: Posed, skin: Tensor, normal: Tensor, softness: float) -> Tensor:
        """Contact, alignment and opposition of the pads."""
        c, hand = self.config, self.hand
        shape, flat = hand.pads.shape, hand.pads.flatten()
        gap = skin[:, flat].unflatten(1, shape) - c.contact_target
        share = torch.where(hand.pad_mask, -gap.detach() / softness, -1e4).softmax(-1)  # the deepest vertices count
        gap = gap.abs()
        huber = torch.where(gap < 1, 0.5 * gap.square() + 0.5, gap)
        contact = (self.pad_weight * (share * huber).sum(-1).clamp(max=c.furthest)).sum(1)

        def of_pads(values: Tensor) -> Tensor:
            return (share.unsqueeze(-1) * values[:, flat].unflatten(1, shape)).sum(2)

        surface = normalize(of_pads(normal[:, : skin.shape[1]]), dim=-1)
        facing = normalize(of_pads(hand.posed_normals(posed.rotations, hand.sample)), dim=-1)
        alignment = (self.pad_weight * (1 + (facing * surface).sum(-1))).sum(1)

        place = of_pads(posed.vertices)
        fingers = (self._finger_share.unsqueeze(-1) * place).sum(1)
        press = normalize(fingers - place[:, self._thumb], dim=-1)  # from the thumb to the fingers
        thumb_side = (0.95 + (surface[:, self._thumb] * press).sum(-1)).relu()
        finger_side = (0.9 - (self._finger_share * (surface * press.unsqueeze(1)).sum(-1)).sum(1)).relu()
        opposition = self._opposed * (thumb_side + finger_side)
        return c.contact * contact + c.alignment * alignment + c.opposition * opposition
