"""What the losses compare with: true distances between hand and object."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Targets:
    """What the losses compare with, per frame; all that does not change when a frame is turned about the vertical.

    Attributes:
        distances: (N, V) float16, signed distances of the true hand's vertices to the object, metres.
        point_distances: (N, P) float16, signed distances of the samples of the object's surface, `ObjectSet.points`, to
            the true hand, metres.
    """

    distances: Tensor
    point_distances: Tensor

    def to(self, device: torch.device | str) -> Targets:
        """The same targets on `device`."""
        return self._each(lambda x: x.to(device))

    def select(self, index: Tensor) -> Targets:
        """Those of the chosen frames."""
        return self._each(lambda x: x[index])

    def _each(self, change: Callable[[Tensor], Tensor]) -> Targets:
        return Targets(change(self.distances), change(self.point_distances))

    def contact(self, distance: float) -> Tensor:
        """(V,) share of frames in which each hand vertex lies within `distance` of the object, or in it."""
        counts = [(part < distance).float().sum(0) for part in self.distances.split(4096)]  # whole, it takes gigabytes
        return torch.stack(counts).sum(0) / len(self.distances)
