"""From starts to grasps: each proposal drawn to a posture of its own, and all descended at once."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from grabnet.cli.checks import Count, Positive, Weight
from grabnet.grasping.descent import DescentConfig, Fading, descend
from grabnet.grasping.grasp_hand import GraspHand, GraspPose
from grabnet.grasping.proposing.grasped_object import GraspedObject
from grabnet.grasping.proposing.posture import PostureConfig
from grabnet.grasping.proposing.proposals import Proposals
from grabnet.open.grasps.energy import EnergyConfig, SynthesisEnergy


@dataclass(frozen=True)
class SynthesisDescentConfig(DescentConfig):
    """Descent (ref. 15), and how far postures differ from the templates."""

    iterations: Count = 70
    rotation_rate: Positive = 0.035
    angle_rate: Positive = 0.035
    memory: Fading = 0.98
    softness: tuple[Positive, Positive] = (8.0, 1.5)
    firmness: tuple[Positive, Positive] = (0.35, 1.45)
    variety: Weight = 0.16  # radians by which each grasp's prior posture is off its template
    spread_variety: Weight = 0.04  # the same for abduction


def optimise(
    scene: GraspedObject,
    hand: GraspHand,
    proposals: Proposals,
    limits: Tensor,
    generator: torch.Generator,
    config: SynthesisDescentConfig,
    energy_config: EnergyConfig,
    posture: PostureConfig,
) -> GraspPose:
    """Grasps (B) that start at the proposals and minimise `SynthesisEnergy`; angles within limits (21, 2)."""
    start = proposals.pose
    spread = torch.full((21,), config.variety)
    spread[[1, 5, 9, 13]] = config.spread_variety
    noise = spread * torch.randn(start.angles.shape, generator=generator)
    prior = (start.angles + noise).clamp(*limits.T)
    energy = SynthesisEnergy(scene, hand, proposals, prior, energy_config, posture)
    return descend(start, hand.anatomy.frame, energy, limits, config)
