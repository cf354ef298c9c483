"""What is measured once of the frames, before training."""

from __future__ import annotations

import torch
from torch import Tensor

from grabnet.cli.progress import track
from grabnet.data.batches import BatchAssembler
from grabnet.data.frames import Frames
from grabnet.data.targets import Targets
from grabnet.geometry.nearest import NearestVertex
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.precision import full_precision


@torch.no_grad()
@full_precision
def compute_targets(frames: Frames, assembler: BatchAssembler, batch_size: int = 64) -> Targets:
    """Pose every frame once and measure it."""
    hand, points = assembler.hand, assembler.object_set.points
    nearest = NearestVertex(hand.faces, hand.v_template)
    targets = Targets(
        torch.empty(len(frames), len(hand.v_template), dtype=torch.float16),
        torch.empty(len(frames), points.shape[1], dtype=torch.float16),
    )
    for start in track(range(0, len(frames), batch_size), "Measuring the frames"):
        part = slice(start, start + batch_size)
        batch = frames.select(torch.arange(len(frames))[part])
        vertices, distances = assembler.measured(batch)
        targets.distances[part] = distances.half()
        rotations = axis_angle_to_matrix(batch.object_orient)
        targets.point_distances[part] = nearest.signed_offset(points[batch.object] @ rotations.mT, vertices).half()
    return targets


@torch.no_grad()
def contact_share(frames: Frames, assembler: BatchAssembler, distance: float, batch_size: int = 256) -> Tensor:
    """(V,) `Targets.contact` of frames, without their other targets."""
    touching = torch.zeros(len(assembler.hand.v_template), dtype=torch.int64)
    for index in track(torch.arange(len(frames)).split(batch_size), "Measuring contact"):
        touching += (assembler.measured(frames.select(index))[1] < distance).sum(0)
    return touching / len(frames)
