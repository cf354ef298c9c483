"""What is learned once from the frames, before training: true distances, object points near the hand, contact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from rich.progress import track
from torch import Tensor

from grabnet.data.batches import BatchAssembler
from grabnet.data.frames import Frames
from grabnet.geometry.nearest import NearestVertex
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.precision import full_precision

MAX_POINTS = torch.iinfo(torch.int16).max  # samples of an object's surface: `Targets.chosen` numbers them


@dataclass(frozen=True)
class Targets:
    """What the losses compare with, per frame; all that does not change when a frame is turned about the vertical.

    Attributes:
        distances: (N, V) float16, signed distances of the true hand's vertices to the object, metres.
        chosen: (N, P) int16, samples of the object's surface, into `ObjectSet.points`, in the order of their distances
            to the true hand; None for all of them, as they are numbered.
        chosen_distances: (N, P) float16, their signed distances to it, metres.
        shares: (P,) of all samples, that each of these stands for.
    """

    distances: Tensor
    chosen: Tensor | None
    chosen_distances: Tensor
    shares: Tensor

    def to(self, device: torch.device | str) -> Targets:
        """The same targets on `device`."""
        return replace(self._each(lambda x: x.to(device)), shares=self.shares.to(device))

    def select(self, index: Tensor) -> Targets:
        """Those of the chosen frames."""
        return self._each(lambda x: x[index])

    def _each(self, change: Callable[[Tensor], Tensor]) -> Targets:
        """What is per frame, changed."""
        chosen = None if self.chosen is None else change(self.chosen)
        return replace(
            self, distances=change(self.distances), chosen=chosen, chosen_distances=change(self.chosen_distances)
        )

    def contact(self, distance: float) -> Tensor:
        """(V,) share of frames in which each hand vertex lies within `distance` of the object, or in it."""
        counts = [(part < distance).float().sum(0) for part in self.distances.split(4096)]  # whole, it takes gigabytes
        return torch.stack(counts).sum(0) / len(self.distances)


def standing_for_all(n: int, n_near: int, n_far: int) -> tuple[Tensor, Tensor]:
    """Which of n samples, in the order of their distances to a hand, stand for all in a mean.

    The nearest stand for themselves. The others, cut into equal parts by their distances, are each one's middle.

    Returns:
        their places in that order (n_near + n_far,), and what share of the n each stands for: 1 together, or less
        without far ones, whose samples then count nothing.
    """
    edges = torch.linspace(n_near, n, n_far + 1).round().long() if n_far else torch.tensor([n_near])
    places = torch.cat([torch.arange(n_near), (edges[:-1] + edges[1:]) // 2])
    return places, torch.cat([torch.ones(n_near), edges.diff().float()]) / n


@torch.no_grad()
@full_precision
def compute_targets(
    frames: Frames, assembler: BatchAssembler, n_near: int, n_far: int, batch_size: int = 64
) -> Targets:
    """Pose every frame once and measure it.

    Args:
        frames: to measure.
        n_near, n_far: surface samples kept per frame, of those near the hand and of the others: `standing_for_all`.
    """
    hand, points = assembler.hand, assembler.object_set.points
    nearest = NearestVertex(hand.faces, len(hand.v_template))
    n_points = points.shape[1]
    places, shares = standing_for_all(n_points, n_near, n_far)
    targets = Targets(
        torch.empty(len(frames), len(hand.v_template), dtype=torch.float16),
        None if n_near == n_points else torch.empty(len(frames), len(places), dtype=torch.int16),
        torch.empty(len(frames), len(places), dtype=torch.float16),
        shares,
    )
    for start in track(range(0, len(frames), batch_size), "Measuring the frames", transient=True):
        part = slice(start, start + batch_size)
        batch = frames.select(torch.arange(len(frames))[part])
        vertices, distances = assembler.measured(batch)
        targets.distances[part] = distances.half()
        rotations = axis_angle_to_matrix(batch.object_orient)
        offset = nearest.signed_offset(points[batch.object] @ rotations.mT, vertices)
        if targets.chosen is not None:
            chosen = offset.abs().argsort(1)[:, places]
            targets.chosen[part] = chosen.short()
            offset = offset.gather(1, chosen)
        targets.chosen_distances[part] = offset.half()
    return targets


@torch.no_grad()
def contact_share(frames: Frames, assembler: BatchAssembler, distance: float, batch_size: int = 256) -> Tensor:
    """`Targets.contact` of frames whose other targets are not wanted."""
    touching = torch.zeros(len(assembler.hand.v_template), dtype=torch.int64)
    for index in track(torch.arange(len(frames)).split(batch_size), "Measuring contact", transient=True):
        touching += (assembler.measured(frames.select(index))[1] < distance).sum(0)
    return touching / len(frames)
