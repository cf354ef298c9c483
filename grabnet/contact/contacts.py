"""How hands meet an object: penetration and contact of each finger, from the distances of the hand's vertices."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from grabnet.body.anatomy import FINGERS

# Metres: ε, below which hand and object touch (paper 3.3).
CONTACT_DISTANCE = 0.0045
# What the numbers of a report are, kept beside them.
DEFINITIONS = {
    "max_penetration_mm": "depth of the deepest hand vertex inside the object",
    "mean_penetration_mm": "mean depth of those hand vertices that are inside the object, 0 where none is",
    "contact_vertices": "hand vertices inside the object or nearer to its surface than contact_distance",
    "distance": "signed distance to the mesh itself, exact (no grid); inside is where the winding number exceeds 1/2",
}


@dataclass(frozen=True, eq=False, kw_only=True)
class Contacts:
    """How N hands meet an object; tensors on one device.

    Attributes:
        distances: (N, V) metres from each hand vertex to the object's surface, negative inside.
        finger: (V,) index into `FINGERS`; -1 on palm and wrist.
        contact_distance: metres, below which a vertex is in contact.
    """

    distances: Tensor
    finger: Tensor
    contact_distance: float = CONTACT_DISTANCE

    def __len__(self) -> int:
        return len(self.distances)

    @property
    def max_penetration(self) -> Tensor:
        """(N,) depth in metres of the deepest hand vertex inside the object; 0 where none is inside."""
        return (-self.distances).amax(1).clamp_min(0)

    @property
    def mean_penetration(self) -> Tensor:
        """(N,) metres: the mean depth over those hand vertices that are inside the object; 0 where none is inside."""
        depth = (-self.distances).clamp_min(0)
        return depth.sum(1) / (depth > 0).sum(1).clamp_min(1)

    @property
    def touching(self) -> Tensor:
        """(N, V) bool: vertices in contact, which those inside the object are."""
        return self.distances < self.contact_distance

    @property
    def contact_vertices(self) -> Tensor:
        """(N, 6) number of vertices in contact of each of `FINGERS`, then of palm and wrist."""
        touching = self.touching.long()
        part = self.finger.remainder(len(FINGERS) + 1)  # -1, palm and wrist, comes last
        return touching.new_zeros(len(self), len(FINGERS) + 1).index_add(1, part, touching)

    @property
    def pinched(self) -> Tensor:
        """(N,) bool: the thumb and at least one other finger are in contact."""
        touching = self.contact_vertices[:, : len(FINGERS)] > 0
        return touching[:, 0] & touching[:, 1:].any(1)
