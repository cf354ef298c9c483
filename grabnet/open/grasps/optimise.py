"""From starts to grasps: gradient descent on pose and angles of a whole batch at once."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.grasping.grasp_hand import GraspHand, GraspPose
from grabnet.open.grasps.energy import EnergyConfig, GraspEnergy
from grabnet.open.grasps.posture import PostureConfig
from grabnet.open.grasps.proposals import Proposals
from grabnet.open.grasps.scene import SynthesisScene


@dataclass(frozen=True)
class OptimiserConfig:
    """Adam's settings and what is ramped during a run (ref. 15)."""

    iterations: int = 70
    wrist_rate: float = 0.0025  # metres
    rotation_rate: float = 0.035  # radians
    angle_rate: float = 0.035  # radians
    final_rate: float = 0.03  # of the rates, reached by a cosine
    softness: tuple[float, float] = (8.0, 1.5)  # mm, at start and end
    firmness: tuple[float, float] = (0.35, 1.45)
    variety: float = 0.16  # radians by which each grasp's prior posture is off its template
    spread_variety: float = 0.04  # the same for abduction


def optimise(
    scene: SynthesisScene,
    hand: GraspHand,
    proposals: Proposals,
    limits: Tensor,
    generator: torch.Generator,
    config: OptimiserConfig,
    energy_config: EnergyConfig,
    posture: PostureConfig,
) -> GraspPose:
    """Grasps (B) that start at the proposals and minimise `GraspEnergy`; angles within limits (21, 2)."""
    start = proposals.pose
    spread = torch.full((21,), config.variety)
    spread[[1, 5, 9, 13]] = config.spread_variety
    noise = spread * torch.randn(start.angles.shape, generator=generator)
    prior = (start.angles + noise).clamp(*limits.T)
    energy = GraspEnergy(scene, hand, proposals, prior, limits, energy_config, posture)

    wrist, angles = start.wrist.clone().requires_grad_(), start.angles.clone().requires_grad_()
    turn = torch.zeros_like(start.wrist).requires_grad_()
    rates = (config.wrist_rate, config.rotation_rate, config.angle_rate)
    groups = [{"params": [x], "lr": rate} for x, rate in zip((wrist, turn, angles), rates, strict=True)]
    adam = torch.optim.Adam(groups, betas=(0.9, 0.98))

    def pose() -> GraspPose:
        return GraspPose(start.rotation @ axis_angle_to_matrix(turn), wrist, angles)

    for iteration in range(config.iterations):
        done = iteration / config.iterations
        for group, rate in zip(adam.param_groups, rates, strict=True):
            group["lr"] = rate * (config.final_rate + (1 - config.final_rate) * (1 + math.cos(math.pi * done)) / 2)
        softness, firmness = (a + (b - a) * done for a, b in (config.softness, config.firmness))
        adam.zero_grad()
        energy(pose(), softness, firmness).sum().backward()
        adam.step()
    with torch.no_grad():
        final = pose()
        return GraspPose(final.rotation.detach(), wrist.detach(), angles.detach().clamp(*limits.T))
