"""What a hand may not go through: the object, seen from skin, fingers and forearm, and the table."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from grabnet.cli.checks import Weight
from grabnet.grasping.grasp_hand import FOREARM_RADIUS, GraspHand
from grabnet.grasping.seen import Seen
from grabnet.grasping.terms import below_table, overlap


@dataclass(frozen=True)
class ObstacleConfig:
    """Weights of overlap per mm² (ref. 15), and lengths in millimetres."""

    skin: Weight = 0.3  # of skin inside the object
    skin_slack: Weight = 1.0
    spheres: Weight = 1.0  # of spheres in the fingers: this keeps them out of thin walls
    sphere_share: Weight = 0.9  # of a sphere's radius
    forearm: Weight = 0.02
    forearm_gap: Weight = 5.0
    table: Weight = 0.4  # of skin or forearm below the table
    table_gap: Weight = 1.0


class Obstacles:
    """Overlap of hands with an object and, where there is one, the table that it stands on.

    Args:
        floor: height (z) of the table, metres; None: no table.
        on_table: (B,) bool, before which hands the table is; before all when omitted.
    """

    def __init__(
        self, hand: GraspHand, config: ObstacleConfig, floor: float | None = None, on_table: Tensor | None = None
    ):
        self.config, self.floor, self.on_table = config, floor, on_table
        self._skin = torch.where(hand.sampled_once, -config.skin_slack, -torch.inf)
        self._spheres = 1e3 * config.sphere_share * hand.radii

    def __call__(self, seen: Seen) -> Tensor:
        """(B,) weighted mm²."""
        c, forearm = self.config, 1e3 * FOREARM_RADIUS
        total = c.skin * overlap(seen.skin, self._skin) + c.spheres * overlap(seen.spheres, self._spheres)
        total = total + c.forearm * overlap(seen.forearm, forearm + c.forearm_gap)
        if self.floor is None:
            return total
        skin, arm = (1e3 * (x[..., 2] - self.floor) for x in (seen.sampled.skin, seen.sampled.forearm))
        below = c.table * (below_table(skin, c.table_gap) + below_table(arm, forearm + c.table_gap))
        return total + (below if self.on_table is None else self.on_table * below)
