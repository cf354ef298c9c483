"""What is learned once from the frames, before training: contact likelihood, and the object's points near the hand."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from rich.progress import track
from torch import Tensor

from grabnet.body.anatomy import vertex_normals
from grabnet.data.batches import BatchAssembler
from grabnet.data.frames import Frames
from grabnet.geometry.nearest import nearest, signed_offset
from grabnet.geometry.rotations import axis_angle_to_matrix


@dataclass(frozen=True)
class Targets:
    """Per frame: `near` (N, P) int16, surface samples of its object nearest to the true hand, and
    `near_distances` (N, P) float16, their signed distances to it in metres. For all frames:
    `contact` (V,), share of frames in which each hand vertex touches the object."""

    near: Tensor
    near_distances: Tensor
    contact: Tensor

    def to(self, device: torch.device | str) -> Targets:
        """The same targets on `device`."""
        return Targets(self.near.to(device), self.near_distances.to(device), self.contact.to(device))


@torch.no_grad()
def compute_targets(
    frames: Frames, assembler: BatchAssembler, n_points: int, contact_distance: float, batch_size: int = 64
) -> Targets:
    """Pose every frame once and measure it.

    Args:
        frames: to measure.
        n_points: surface samples kept per frame: those nearest to the hand, or all when it equals their number.
        contact_distance: metres within which a hand vertex counts as touching (spec 4).
    """
    points = assembler.object_set.points
    faces = assembler.hand.faces
    near = torch.empty(len(frames), n_points, dtype=torch.int16)
    near_distances = torch.empty(len(frames), n_points, dtype=torch.float16)
    touching = torch.zeros(len(assembler.hand.v_template))
    for start in track(range(0, len(frames), batch_size), "Measuring the training frames", transient=True):
        part = slice(start, start + batch_size)
        batch = frames.select(torch.arange(len(frames))[part])
        vertices = assembler.posed(batch)[2]
        rotations = axis_angle_to_matrix(batch.object_orient)
        touching += (assembler.object_set.distances(vertices, batch.object, rotations) < contact_distance).sum(0)
        candidates = points[batch.object] @ rotations.mT
        if n_points < candidates.shape[1]:
            # Every fourth vertex is near enough for choosing points (≈ 3 mm), and four times cheaper.
            sparse = vertices[:, ::4]
            offset = candidates - sparse.gather(1, nearest(candidates, sparse).unsqueeze(-1).expand(-1, -1, 3))
            chosen = offset.square().sum(-1).topk(n_points, largest=False, sorted=False).indices.sort().values
        else:
            chosen = torch.arange(n_points).expand(len(batch), -1)
        at = candidates.gather(1, chosen.unsqueeze(-1).expand(-1, -1, 3))
        near[part] = chosen.to(torch.int16)
        near_distances[part] = signed_offset(at, vertices, vertex_normals(vertices, faces)).to(torch.float16)
    return Targets(near, near_distances, touching / max(len(frames), 1))
