"""The cameras of a motion-capture system, and which markers they see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from torch import Tensor

from grabnet.cli.checks import Count, Filled, Positive, in_range
from grabnet.errors import UserError
from grabnet.geometry.sight import Occluder

# Cameras asked at once: most markers are seen by some of the first, and need no others.
_ROUND = 6


@dataclass(frozen=True)
class Rig:
    """Cameras on circles around what they capture, looking inwards.

    Attributes:
        cameras: of all circles together.
        radius: of the circles, metres.
        heights: of the circles above the floor, metres.
        views: cameras that must see a marker; a place in space takes two.
        marker: radius of the smallest markers, metres: lines of sight start so far from the skin.

    Raises:
        UserError: a value out of range; more views than cameras.
    """

    cameras: Count = 54
    radius: Positive = 3.5
    heights: Annotated[Sequence[Positive], Filled()] = (1.2, 2.6)
    views: Count = 2
    marker: Positive = 0.0015

    def __post_init__(self):
        in_range(self, "rig.")
        if self.views > self.cameras:
            raise UserError(f"rig.views is {self.views}; there are {self.cameras} cameras.")

    def places(self, middle: np.ndarray) -> Tensor:
        """(C, 3) where the cameras are, around the vertical axis through `middle` (3); neighbours in the list are far
        from each other."""
        number = np.arange(self.cameras)
        golden = np.pi * (3 - np.sqrt(5))  # spreads any number of angles
        height = np.array(self.heights)[number % len(self.heights)]
        around = self.radius * np.stack([np.cos(golden * number), np.sin(golden * number)], 1) + middle[:2]
        return torch.as_tensor(np.column_stack([around, height])).float()


def seen(rig: Rig, cameras: Tensor, markers: Tensor, occluder: Occluder) -> Tensor:
    """(M,) bool: which markers enough cameras see past the occluder.

    Args:
        rig: the cameras.
        cameras: (C, 3) where they are.
        markers: (M, 3) where the lines of sight start, outside the occluder.
        occluder: what may be in the way.
    """
    views = torch.zeros(len(markers), dtype=torch.int64)
    for some in cameras.split(_ROUND):
        left = (views < rig.views).nonzero().squeeze(1)
        if not len(left):
            break
        start = markers[left].repeat_interleave(len(some), 0)
        hidden = occluder.hides(start, some.repeat(len(left), 1))
        views[left] += (~hidden).view(len(left), -1).sum(1)
    return views >= rig.views
