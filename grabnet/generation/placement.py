"""How one object stands in front of the hand, and the way of hands back to its mesh.

Four frames take part:

- mesh: the frame and units of the object's file;
- object: the same directions up to a rotation, in metres, z up;
- world: the object turned about its centre, which lies at the origin, metres, z up;
- right-hand world: the world itself for right hands; for left hands its mirror image, in which they are right hands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from grabnet.body.hand import HandModel, HandParameters
from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.conventions import Conventions
from grabnet.geometry.object_mesh import ObjectMesh
from grabnet.geometry.placed import PlacedObjects


@dataclass(frozen=True, eq=False)
class Placement:
    """Ways in which one object stands in the world; candidate i takes way i modulo their number K.

    Attributes:
        to_object: (4, 4) float64 similarity, mesh to object.
        centre: (3,) point of the object that lies at the origin of the world, object frame, metres.
        turns: (K, 3, 3) rotations of the object in the right-hand world; for left hands, of its mirror image there.
        mirror: (3, 3) world to right-hand world: the identity, or a reflection in x for left hands.
        samples: (1, N, 3) points of the object that distances of the hand are measured to, as in `PlacedObjects`.
        basis_samples: (1, N, 3) likewise, for basis points.
    """

    to_object: np.ndarray
    centre: Tensor
    turns: Tensor
    mirror: Tensor
    samples: Tensor | None = None
    basis_samples: Tensor | None = None

    @classmethod
    def of(cls, placed: ObjectMesh, turns: Tensor, side: str, known: Conventions) -> Placement:
        """An object about its centre.

        Args:
            placed: the object.
            turns: (K, 3, 3) rotations, object to world.
            side: "right" or "left", of the hands.
            known: how it is to be shown to the networks.
        """
        mirror = torch.diag(turns.new_tensor([1.0 if side == "right" else -1.0, 1.0, 1.0]))
        centre = torch.as_tensor(known.centre_of(placed.solid), device=turns.device)
        needs_points = (known.distance_to == "samples", known.basis_to == "samples")
        points = known.vertices_in_use(placed.solid).to(turns).unsqueeze(0) if any(needs_points) else None
        return cls(placed.to_object, centre, turns, mirror, *(points if needed else None for needed in needs_points))

    @property
    def scale(self) -> float:
        """Metres per unit of the mesh."""
        return np.linalg.det(self.to_object[:3, :3]) ** (1 / 3)

    @property
    def axes(self) -> Tensor:
        """(3, 3) rotation, mesh to object."""
        return self.turns.new_tensor(self.to_object[:3, :3] / self.scale)

    @property
    def shift(self) -> Tensor:
        """(3,) origin of the mesh in the object frame, metres."""
        return self.turns.new_tensor(self.to_object[:3, 3])

    def objects(self, atlas: SDFAtlas) -> PlacedObjects:
        """The object in the right-hand world, its K ways, for an atlas that holds it alone."""
        n = len(self.turns)
        index = torch.zeros(n, dtype=torch.int64, device=self.turns.device)
        rotations, centres = self.turns @ self.mirror, self.centre.expand(n, 3)
        return PlacedObjects(atlas, index, rotations, centres, self.samples, self.basis_samples)

    def transforms(self, ways: Tensor) -> Tensor:
        """(N, 4, 4) mesh to world, of ways (N,)."""
        rotation, offset = self._mesh_to_world(ways)
        transform = torch.eye(4, device=rotation.device).repeat(len(ways), 1, 1)
        transform[:, :3, :3], transform[:, :3, 3] = rotation * self.scale, offset
        return transform

    def hands_to_mesh(
        self, hands: HandParameters, ways: Tensor, hand: HandModel, rest: Tensor
    ) -> tuple[HandParameters, Tensor]:
        """N hands along the axes of the mesh and from its origin, in metres.

        Args:
            hands: right hands in the right-hand world.
            ways: (N,) in which the object stands before each.
            hand: their model.
            rest: (V, 3) rest vertices.

        Returns:
            parameters of the hand model of `side`, and vertices (N, V, 3).
        """
        rotation, offset = self._mesh_to_world(ways)
        # The hands move as right hands, in the mirror image of the mesh's frame.
        back = (self.mirror @ rotation @ self.mirror).mT
        hands = hand.moved(hands, back, -(back @ (offset @ self.mirror).unsqueeze(-1)).squeeze(-1), rest)
        parameters = HandParameters(
            self.mirror @ hands.global_orient @ self.mirror,
            self.mirror @ hands.hand_pose @ self.mirror,
            hands.transl @ self.mirror,
        )
        return parameters, hand(hands, rest).vertices @ self.mirror

    def to_object_frame(self, points: Tensor) -> Tensor:
        """Points (..., 3) along the axes of the mesh and from its origin, in metres, in the object frame."""
        return points @ self.axes.mT + self.shift

    def _mesh_to_world(self, ways: Tensor) -> tuple[Tensor, Tensor]:
        """Rotations (N, 3, 3) and offsets (N, 3) in metres, of the mesh taken in metres."""
        turned = self.mirror @ self.turns[ways] @ self.mirror
        return turned @ self.axes, turned @ (self.shift - self.centre)
