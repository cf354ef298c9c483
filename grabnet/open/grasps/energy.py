"""What a synthesised grasp minimises: pads touch, nothing overlaps, the hand stays at ease; millimetres and cosines."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from grabnet.grasping import terms
from grabnet.grasping.grasp_hand import GraspHand, GraspPose
from grabnet.grasping.obstacles import ObstacleConfig, Obstacles
from grabnet.grasping.proposing.grasped_object import GraspedObject
from grabnet.grasping.proposing.posture import PostureConfig, discomfort
from grabnet.grasping.proposing.proposals import Proposals, pad_weights
from grabnet.grasping.proposing.templates import regularity
from grabnet.grasping.seen import Seen


@dataclass(frozen=True)
class EnergyConfig(ObstacleConfig):
    """Weights (ref. 15), and lengths in millimetres."""

    contact: float = 1.0  # per mm of a pad's distance
    contact_target: float = -0.6  # pads sink in a little: skin yields
    furthest: float = 40.0  # a pad further away than this no longer pulls
    self_overlap: float = 1.0  # per mm² of overlap between fingers
    alignment: float = 4.0  # pads face the surface they touch
    opposition: float = 8.0  # thumb and fingers press against each other
    power_opposition: float = 0.3  # share of that in a power grasp, where the palm helps
    prior: float = 1.2  # per rad² from the template
    coupling: float = 2.0  # DIP = dip_per_pip × PIP
    dip_per_pip: float = 0.6
    spread: float = 4.0
    neighbours: float = 1.5
    posture: float = 30.0  # per unit of discomfort


class SynthesisEnergy:
    """Energy of a batch of grasps of one subject on one object.

    Args:
        scene, hand: object and subject.
        proposals: kinds, table flags and directions of the batch.
        prior: (B, 21) angles that the posture is drawn to.
    """

    def __init__(
        self,
        scene: GraspedObject,
        hand: GraspHand,
        proposals: Proposals,
        prior: Tensor,
        config: EnergyConfig,
        posture: PostureConfig,
    ):
        self.scene, self.hand, self.proposals, self.prior = scene, hand, proposals, prior
        self.config, self.posture = config, posture
        self.obstacles = Obstacles(hand, config, scene.floor, proposals.on_table)
        self.pad_weight = pad_weights(hand)[proposals.kind]
        self._thumb = hand.pad_names.index("thumb3")
        fingers = self.pad_weight.clone()
        fingers[:, self._thumb] = 0
        self._opposing = fingers / fingers.sum(1, keepdim=True)
        palm_helps = self.pad_weight[:, hand.pad_names.index("palm_mcp")] > 0
        self._opposed = torch.where(palm_helps, config.power_opposition, 1.0)

    def __call__(self, pose: GraspPose, softness: float, firmness: float, iteration: int = 0) -> Tensor:
        """(B,) energies.

        Args:
            softness: mm, over which a pad's contact is spread among its vertices; low: only the deepest counts.
            firmness: factor on all overlap with object and table, raised as the optimisation proceeds.
        """
        c = self.config
        seen = Seen.of(self.hand, pose, self.scene.distance_and_normal, softness)
        energy = firmness * self.obstacles(seen) + c.self_overlap * self.hand.self_overlap(seen.sampled.spheres)
        energy = energy + c.contact * terms.contact(seen.pads, self.pad_weight, c.contact_target, c.furthest)
        energy = energy + c.alignment * terms.alignment(seen.pads, self.pad_weight)
        energy = energy + c.opposition * self._opposed * terms.opposition(seen.pads, self._thumb, self._opposing)

        coupling, spread, neighbours = regularity(pose.angles, c.dip_per_pip)
        energy = energy + c.coupling * coupling + c.spread * spread + c.neighbours * neighbours
        energy = energy + c.prior * terms.strayed(pose.angles, self.prior)
        frame = self.hand.anatomy.frame
        uneasy = discomfort(pose.rotation, frame, self.proposals.on_table, self.proposals.forward, self.posture)
        return energy + c.posture * uneasy
