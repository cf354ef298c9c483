"""What is learned once from the frames, before training: true distances, object points near the hand, contact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from rich.progress import track
from torch import Tensor

from grabnet.data.batches import BatchAssembler
from grabnet.data.frames import Frames
from grabnet.geometry.nearest import NearestVertex
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.precision import full_precision

MAX_POINTS = torch.iinfo(torch.int16).max  # samples of an object's surface: `Targets.near` numbers them


@dataclass(frozen=True)
class Targets:
    """What the losses compare with, per frame; all that does not change when a frame is turned about the vertical.

    Attributes:
        distances: (N, V) float16, signed distances of the true hand's vertices to the object, metres.
        near: (N, P) int16, samples of the object's surface, into `ObjectSet.points`: those nearest to the true hand;
            None for all of them, as they are numbered.
        near_distances: (N, P) float16, their signed distances to it, metres.
    """

    distances: Tensor
    near: Tensor | None
    near_distances: Tensor

    def to(self, device: torch.device | str) -> Targets:
        """The same targets on `device`."""
        return self._each(lambda x: x.to(device))

    def select(self, index: Tensor) -> Targets:
        """Those of the chosen frames."""
        return self._each(lambda x: x[index])

    def _each(self, change: Callable[[Tensor], Tensor]) -> Targets:
        near = None if self.near is None else change(self.near)
        return Targets(change(self.distances), near, change(self.near_distances))

    def contact(self, distance: float) -> Tensor:
        """(V,) share of frames in which each hand vertex lies within `distance` of the object, or in it."""
        counts = [(part < distance).float().sum(0) for part in self.distances.split(4096)]  # whole, it takes gigabytes
        return torch.stack(counts).sum(0) / len(self.distances)


@torch.no_grad()
@full_precision
def compute_targets(frames: Frames, assembler: BatchAssembler, n_points: int, batch_size: int = 64) -> Targets:
    """Pose every frame once and measure it.

    Args:
        frames: to measure.
        n_points: surface samples kept per frame: those nearest to the hand, or all when it equals their number.
    """
    hand, points = assembler.hand, assembler.object_set.points
    nearest = NearestVertex(hand.faces, len(hand.v_template))
    targets = Targets(
        torch.empty(len(frames), len(hand.v_template), dtype=torch.float16),
        None if n_points == points.shape[1] else torch.empty(len(frames), n_points, dtype=torch.int16),
        torch.empty(len(frames), n_points, dtype=torch.float16),
    )
    for start in track(range(0, len(frames), batch_size), "Measuring the frames", transient=True):
        part = slice(start, start + batch_size)
        batch = frames.select(torch.arange(len(frames))[part])
        vertices, distances = assembler.measured(batch)
        targets.distances[part] = distances.half()
        rotations = axis_angle_to_matrix(batch.object_orient)
        offset = nearest.signed_offset(points[batch.object] @ rotations.mT, vertices)
        if targets.near is not None:
            chosen = offset.abs().topk(n_points, largest=False, sorted=False).indices.sort().values
            targets.near[part] = chosen.short()
            offset = offset.gather(1, chosen)
        targets.near_distances[part] = offset.half()
    return targets


@torch.no_grad()
def contact_share(frames: Frames, assembler: BatchAssembler, distance: float, batch_size: int = 256) -> Tensor:
    """`Targets.contact` of frames whose other targets are not wanted."""
    touching = torch.zeros(len(assembler.hand.v_template), dtype=torch.int64)
    for index in track(torch.arange(len(frames)).split(batch_size), "Measuring contact", transient=True):
        touching += (assembler.measured(frames.select(index))[1] < distance).sum(0)
    return touching / len(frames)
