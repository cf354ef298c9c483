"""Gradient descent on pose and angles of a whole batch of hands at once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor

from grabnet.cli.checks import Amount, Positive, Range, in_range
from grabnet.errors import UserError
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.grasping.grasp_hand import GraspPose

Fading = Annotated[float, Range(0, 0.9999)]  # share of what was that is kept from step to step


@dataclass(frozen=True)
class DescentConfig:
    """Adam's settings and what is ramped during a run (ref. 15)."""

    iterations: Amount = 60
    wrist_rate: Positive = 0.0025  # metres
    rotation_rate: Positive = 0.03  # radians
    angle_rate: Positive = 0.03  # radians
    final_rate: Positive = 0.03  # of the rates, reached by a cosine
    momentum: Fading = 0.9  # Adam's β₁
    memory: Fading = 0.95  # Adam's β₂: short, so that a start deep inside does not slow what follows
    softness: tuple[Positive, Positive] = (6.0, 1.5)  # mm, over which a pad's contact is spread, at start and end
    firmness: tuple[Positive, Positive] = (0.2, 6.0)  # factor on all overlap with the object, at start and end

    def __post_init__(self):
        in_range(self, "optimiser.")
        for name in ("softness", "firmness"):
            if len(ends := tuple(getattr(self, name))) != 2:
                raise UserError(f"optimiser.{name} is {list(ends)}; it must be two numbers, at start and end.")


# (pose, softness, firmness, iteration) → (B,) energies.
Energy = Callable[[GraspPose, float, float, int], Tensor]


def descend(start: GraspPose, frame: Tensor, energy: Energy, limits: Tensor, config: DescentConfig) -> GraspPose:
    """Hands of less energy, whose angles stay within limits (A, 2); nothing waits for the device on the way.

    The wrist moves and turns along the hand's own directions, the rows of `frame` (3, 3), `Anatomy.frame`: Adam's steps
    differ by direction, and must not depend on the coordinates of model or object.
    """
    move, turn = (torch.zeros_like(start.wrist).requires_grad_() for _ in range(2))
    angles = start.angles.clamp(*limits.T).requires_grad_()
    directions = start.rotation @ frame.mT
    rates = (config.wrist_rate, config.rotation_rate, config.angle_rate)
    groups = [{"params": [x], "lr": rate} for x, rate in zip((move, turn, angles), rates, strict=True)]
    adam = torch.optim.Adam(groups, betas=(config.momentum, config.memory))

    def share_of_rate(iteration: int) -> float:
        falling = (1 + math.cos(math.pi * iteration / config.iterations)) / 2
        return config.final_rate + (1 - config.final_rate) * falling

    schedule = torch.optim.lr_scheduler.LambdaLR(adam, share_of_rate)

    def pose() -> GraspPose:
        wrist = start.wrist + (directions @ move.unsqueeze(-1)).squeeze(-1)
        return GraspPose(start.rotation @ axis_angle_to_matrix(turn @ frame), wrist, angles)

    with torch.enable_grad():
        for iteration in range(config.iterations):
            done = iteration / config.iterations
            softness, firmness = (a * (b / a) ** done for a, b in (config.softness, config.firmness))
            adam.zero_grad()
            energy(pose(), softness, firmness, iteration).sum().backward()
            adam.step()
            schedule.step()
            with torch.no_grad():
                angles.clamp_(*limits.T)
    return GraspPose(*(x.detach() for x in pose()))
