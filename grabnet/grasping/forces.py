"""Whether contacts can hold an object: forces within friction cones against gravity from six directions."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from grabnet.cli.checks import Count, Positive, Weight, in_range
from grabnet.grasping.seen import Pads


@dataclass(frozen=True)
class ForceConfig:
    """How contacts bear a load of weight 1."""

    friction: Weight = 0.5  # dry skin on common materials is .5–1
    reach: Positive = 6.0  # mm over which a pad's contact fades with its distance
    arm: Positive = 0.05  # metres: a torque counts as much as a force at this distance
    effort: Positive = 0.005  # squared contact forces against squared load left over
    iterations: Count = 8  # of the forces, at each look

    def __post_init__(self):
        in_range(self, "optimiser.forces.")


def wrenches(pads: Pads, centre: Tensor, config: ForceConfig) -> Tensor:
    """(B, 6, 4·P) force and torque of unit pressure along four edges of each pad's friction cone.

    Scaled by how nearly the pad touches; pressing in counts no more than touching.

    Args:
        centre: (B or 1, 3) metres, where gravity pulls.
    """
    inward = -pads.surface
    side, other = across(inward)
    tangents = config.friction * torch.stack([side, -side, other, -other], 2)
    force = inward.unsqueeze(2) + tangents  # (B, P, 4, 3)
    arm = (pads.place - centre.unsqueeze(1)) / config.arm
    torque = torch.linalg.cross(arm.unsqueeze(2).expand_as(force), force)
    touching = torch.exp(-pads.distance.relu() / config.reach)
    return (torch.cat([force, torque], -1) * touching[..., None, None]).flatten(1, 2).mT


def across(normal: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit vectors (..., 3) perpendicular to each other and to unit normals (..., 3) (Duff et al. 2017)."""
    x, y, z = normal.unbind(-1)
    sign = torch.copysign(torch.ones_like(z), z)
    a = -1 / (sign + z)
    b = x * y * a
    side = torch.stack([1 + sign * x * x * a, sign * b, -sign * x], -1)
    return side, torch.stack([b, sign + y * y * a, -y], -1)


class HeldForces:
    """Contact forces of B grasps against six loads, kept from one look to the next.

    Args:
        wrist: (B, 3), for number, device and precision.
        n_pads: P.
    """

    def __init__(self, wrist: Tensor, n_pads: int, config: ForceConfig):
        self.config = config
        self._forces = wrist.new_zeros(len(wrist), 4 * n_pads, 6)
        directions = torch.cat([torch.eye(3), -torch.eye(3)], 1)
        self._load = torch.cat([directions, torch.zeros(3, 6)]).to(wrist)  # a column for each direction

    def unmet(self, pads: Pads, centre: Tensor, solve: bool) -> Tensor:
        """(B,) mean over six directions of gravity of the squared share of the load that is left, plus the effort.

        The forces are the minimiser of just that, so that its gradient is that at fixed forces (envelope theorem).

        Args:
            solve: False keeps the forces of the look before.
        """
        matrix = wrenches(pads, centre, self.config)
        if solve:
            with torch.no_grad():
                self._forces = solved(matrix, self._load, self._forces, self.config)
        left = matrix @ self._forces - self._load
        effort = self.config.effort * self._forces.square().sum((1, 2))
        return (left.square().sum((1, 2)) + effort) / 6


def solved(matrix: Tensor, load: Tensor, forces: Tensor, config: ForceConfig) -> Tensor:
    """Non-negative forces (B, E, D) nearest to the minimum of |matrix f − load|² + effort |f|², accelerated descent.

    Args:
        matrix: (B, 6, E). load: (6, D). forces: (B, E, D) to start from.
    """
    gram = matrix @ matrix.mT
    step = 1 / (gram.abs().sum(2).amax(1) + config.effort)[:, None, None]
    ahead = forces
    for i in range(config.iterations):
        slope = matrix.mT @ (matrix @ ahead - load) + config.effort * ahead
        moved = (ahead - step * slope).relu()
        ahead = moved + i / (i + 3) * (moved - forces)
        forces = moved
    return forces
