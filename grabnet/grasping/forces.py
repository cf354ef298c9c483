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


def cones(pads: Pads, friction: float) -> Tensor:
    """(B, P, 4, 3) edges of the pads' friction cones: forces on the object, each of unit pressure."""
    inward = -pads.surface
    side, other = across(inward)
    return inward.unsqueeze(2) + friction * torch.stack([side, -side, other, -other], 2)


def touching(pads: Pads, config: ForceConfig) -> Tensor:
    """(B, P) how nearly each pad touches, at most 1: pressing in counts no more than touching."""
    return torch.exp(-pads.distance.relu() / config.reach)


def wrenches(pads: Pads, centre: Tensor, config: ForceConfig) -> Tensor:
    """(B, 6, 4·P) force and torque about `centre` (B or 1, 3) of the cones' edges, by how nearly the pads touch."""
    force = cones(pads, config.friction)
    arm = (pads.place - centre.unsqueeze(1)) / config.arm
    torque = torch.linalg.cross(arm.unsqueeze(2).expand_as(force), force)
    return (torch.cat([force, torque], -1) * touching(pads, config)[..., None, None]).flatten(1, 2).mT


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
        self._pressures = wrist.new_zeros(len(wrist), 4 * n_pads, 6)
        self._forces = wrist.new_zeros(len(wrist), n_pads, 18)  # their three coordinates, for each of six loads
        directions = torch.cat([torch.eye(3), -torch.eye(3)], 1)
        self._load = torch.cat([directions, torch.zeros(3, 6)]).to(wrist)  # a column for each direction of gravity

    def unmet(self, pads: Pads, centre: Tensor, solve: bool) -> Tensor:
        """(B,) mean over six directions of gravity of the squared share of the load that is left, plus the effort.

        The forces nearly minimise just that, so that its gradient is that at fixed forces (envelope theorem).

        Args:
            centre: (B or 1, 3) metres, where gravity pulls.
            solve: False keeps the forces of the look before.
        """
        if solve:
            self._solve(pads, centre)
        touch = touching(pads, self.config).unsqueeze(1)
        arm = (pads.place - centre.unsqueeze(1)).mT / self.config.arm
        force, *moments = (torch.cat([touch, touch * arm], 1) @ self._forces).unflatten(2, (3, 6)).unbind(1)
        x, y, z = moments  # (B, 3, 6): the sums of one coordinate of the arm times each of the force
        torque = torch.stack([y[:, 2] - z[:, 1], z[:, 0] - x[:, 2], x[:, 1] - y[:, 0]], 1)
        left = torch.cat([force, torque], 1) - self._load
        effort = self.config.effort * self._pressures.square().sum((1, 2))
        return (left.square().sum((1, 2)) + effort) / 6

    @torch.no_grad()
    def _solve(self, pads: Pads, centre: Tensor) -> None:
        self._pressures = solved(wrenches(pads, centre, self.config), self._load, self._pressures, self.config)
        edges = cones(pads, self.config.friction)
        pressures = self._pressures.unflatten(1, edges.shape[1:3])
        self._forces = (edges.mT @ pressures).flatten(2)


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
