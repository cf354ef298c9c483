"""Objects in front of a hand: what a network is conditioned on, in training and in use."""

from __future__ import annotations

from dataclasses import dataclass, replace

from torch import Tensor

from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.nearest import nearest_point_distance
from grabnet.precision import full_precision


@dataclass(frozen=True, eq=False)
class PlacedObjects:
    """B objects in a common world: metres, z up, the centre of each object at the origin.

    Attributes:
        atlas: signed distances of the objects.
        index: (B,) int64, objects in the atlas.
        rotations: (B, 3, 3) orthogonal, object frame to world; a reflection shows the object mirrored.
        centres: (B, 3) point of each object, in its own frame, that lies at the origin of the world.
        samples: (O, P, 3) points of all objects of the atlas, along the axes of the object frame, from the centre.
            With them `distances` are unsigned, to the nearest sample; without them signed, to the surface.
        basis_samples: (O, N, 3) likewise, for `basis_distances`, which without them are to the surface.
    """

    atlas: SDFAtlas
    index: Tensor
    rotations: Tensor
    centres: Tensor
    samples: Tensor | None = None
    basis_samples: Tensor | None = None

    def __len__(self) -> int:
        return len(self.index)

    @full_precision
    def distances(self, points: Tensor) -> Tensor:
        """Distances (B, N) in metres of world points (B, N, 3) to each element's object: see `samples`."""
        if self.samples is not None:
            return nearest_point_distance(points @ self.rotations, self.samples[self.index])
        return self.signed_distances(points)

    def signed_distances(self, points: Tensor) -> Tensor:
        """Signed distances (B, N) in metres of world points (B, N, 3) to the surface, negative inside."""
        return self.atlas(points, self.index, self.rotations, self.centres)

    def surface(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Signed distances (B, N) in metres of world points (B, N, 3), and their gradients (B, N, 3) in the world.

        Near the surface the gradient is the unit normal, outward. Only the distances are differentiable.
        """
        return self.atlas.with_gradient(points, self.index, self.rotations, self.centres)

    @full_precision
    def basis_distances(self, basis: Tensor) -> Tensor:
        """Unsigned distances (B, P) in metres of world points (P, 3) to each element's object: see `basis_samples`."""
        if self.basis_samples is not None:
            return nearest_point_distance(basis @ self.rotations, self.basis_samples[self.index])
        return self.atlas.basis_distances(basis, self.index, self.rotations, self.centres)

    def select(self, rows: Tensor | slice) -> PlacedObjects:
        """The chosen elements."""
        return replace(self, index=self.index[rows], rotations=self.rotations[rows], centres=self.centres[rows])
