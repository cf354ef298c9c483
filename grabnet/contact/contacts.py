"""How hands meet an object, counted from the distances of their vertices."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from grabnet.body.anatomy import FINGERS


@dataclass(frozen=True, eq=False, kw_only=True)
class Contacts:
    """How N hands meet an object; tensors on one device.

    Attributes:
        distances: (N, V) metres from each hand vertex to the object's surface, negative inside.
        finger: (V,) index into `FINGERS`; -1 on palm and wrist.
        contact_distance: metres, below which a vertex is in contact (ref. 4).
    """

    distances: Tensor
    finger: Tensor
    contact_distance: float = 0.0045

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
    def contact_vertices(self) -> Tensor:
        """(N, 6) number of vertices in contact (inside counts) of each of `FINGERS`, then of palm and wrist."""
        touching = (self.distances < self.contact_distance).long()
        part = self.finger.remainder(len(FINGERS) + 1)  # -1, palm and wrist, comes last
        return touching.new_zeros(len(self), len(FINGERS) + 1).index_add(1, part, touching)

    @property
    def pinched(self) -> Tensor:
        """(N,) bool: the thumb and at least one other finger are in contact."""
        touching = self.contact_vertices[:, : len(FINGERS)] > 0
        return touching[:, 0] & touching[:, 1:].any(1)
