"""Training batches, assembled on the device from the frames store: geometry is recomputed, never stored (ref. 14)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from grabnet.body.hand import HandModel, HandParameters
from grabnet.data.frames import Frames
from grabnet.data.objects import ObjectSet
from grabnet.data.targets import Targets
from grabnet.geometry.placed import PlacedObjects
from grabnet.geometry.rotations import about_z, axis_angle_to_matrix
from grabnet.precision import full_precision


@dataclass(frozen=True)
class GraspBatch:
    """B hands on objects in the object-centred world frame (`ObjectSet.place`), metres.

    Attributes:
        objects: as they stand before the hand.
        hand: true parameters.
        rest: (B, V, 3) rest vertices of each frame's subject.
        vertices: (B, V, 3) of the true hand.
        distances: (B, V) of these vertices to the object, as `objects.distances` gives them.
        points: (B, P, 3) samples of the object's surface.
        point_distances: (B, P) their signed distances to the hand; None for hands that they were not measured for.
        noisy: hands near the true ones, which RefineNet starts from; None without such.
    """

    objects: PlacedObjects
    hand: HandParameters
    rest: Tensor
    vertices: Tensor
    distances: Tensor
    points: Tensor
    point_distances: Tensor | None
    noisy: HandParameters | None = None

    def __len__(self) -> int:
        return len(self.objects)

    @full_precision
    def with_hands(self, model: HandModel, hand: HandParameters, rest: Tensor) -> GraspBatch:
        """The same objects with other true hands.

        Args:
            model: the hand model.
            hand: parameters of B hands.
            rest: (B, V, 3) their rest vertices.
        """
        vertices = model(hand, rest).vertices
        distances = self.objects.distances(vertices)
        return replace(self, hand=hand, rest=rest, vertices=vertices, distances=distances, point_distances=None)


class BatchAssembler(nn.Module):
    """Makes a `GraspBatch` of chosen frames.

    Args:
        hand: the hand model.
        v_template: (S, V, 3) rest vertices per subject.
        object_set: geometry of the objects that the frames number.
    """

    def __init__(self, hand: HandModel, v_template: Tensor, object_set: ObjectSet):
        super().__init__()
        self.hand = hand
        self.object_set = object_set
        self.register_buffer("v_template", v_template, False)

    @full_precision
    def measured(self, frames: Frames) -> tuple[Tensor, Tensor]:
        """Posed vertices (N, V, 3) of the frames and their distances (N, V) to the object, metres."""
        rotations = axis_angle_to_matrix(frames.object_orient)
        hand = self._about_centre(frames.hand(), frames, rotations)
        vertices = self.hand(hand, self.v_template[frames.subject]).vertices
        return vertices, self.object_set.place(frames.object, rotations).distances(vertices)

    @torch.no_grad()
    @full_precision
    def forward(self, frames: Frames, targets: Targets, turn: bool) -> GraspBatch:
        """Assemble.

        Args:
            frames: of the batch.
            targets: theirs.
            turn: rotate each frame about the vertical by a random angle (training's augmentation).
        """
        rotations, rest = axis_angle_to_matrix(frames.object_orient), self.v_template[frames.subject]
        hand, noisy = (self._about_centre(hand, frames, rotations) for hand in (frames.hand(), frames.noisy_hand()))
        if turn:
            about = about_z(torch.rand(len(frames), device=rotations.device) * (2 * torch.pi))
            rotations = about @ rotations
            hand = self.hand.moved(hand, about, rest=rest)
            noisy = None if noisy is None else self.hand.moved(noisy, about, rest=rest)
        return GraspBatch(
            objects=self.object_set.place(frames.object, rotations),
            hand=hand,
            rest=rest,
            vertices=self.hand(hand, rest).vertices,
            distances=targets.distances.to(rest.dtype),
            points=self.object_set.points[frames.object] @ rotations.mT,
            point_distances=targets.point_distances.to(rest.dtype),
            noisy=noisy,
        )

    def _about_centre(self, hand: HandParameters | None, frames: Frames, rotations: Tensor) -> HandParameters | None:
        """Hands of frames, which have the origin at the mean vertex, about the objects' centres."""
        if hand is None:
            return None
        return hand._replace(transl=hand.transl + self.object_set.mean_vertices(frames.object, rotations))
