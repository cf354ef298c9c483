"""Grasps: hands on one object, in the frame and units of the object's own mesh."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from torch import Tensor

from grabnet.body.anatomy import FINGERS
from grabnet.body.hand import HandParameters
from grabnet.geometry.mesh import Mesh

# Metres: a hand vertex nearer to the object is in contact (ref. 4).
CONTACT_DISTANCE = 0.0045

# What the numbers of a report are, kept beside them.
DEFINITIONS = {
    "max_penetration_mm": "depth of the deepest hand vertex inside the object",
    "mean_penetration_mm": "mean depth of those hand vertices that are inside the object, 0 where none is",
    "contact_vertices": f"hand vertices inside the object or nearer to its surface than {1000 * CONTACT_DISTANCE:g} mm",
    "distance": "signed distance to the mesh itself, exact (no grid); inside is where the winding number exceeds 1/2",
}


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


@dataclass(frozen=True, eq=False, kw_only=True)
class Grasps(Contacts):
    """N hands on `mesh`; tensors on the CPU.

    Attributes:
        mesh: the object, as in its file.
        to_object: (4, 4) similarity from the mesh's frame and units to metres, z up.
        side: "right" or "left".
        seed: of the draw; grasp i of a seed is the same whatever N.
        parameters: N poses of the hand model, along the axes of the mesh's frame and from its origin, but in metres
            as hand models are: posed vertices times `units_per_metre` are `vertices`.
        betas: (N, n) hand shapes.
        object_transform: (N, 4, 4) from the mesh's frame to the world that each grasp was made in: metres, z up, turned
            as the networks saw the object, origin at its centroid.
        vertices: (N, V, 3) hands in the mesh's frame and units. faces: (F, 3), outward.
        distances: as in `Contacts`, exact within 1 cm of the mesh.
    """

    mesh: Mesh
    to_object: np.ndarray
    side: str
    seed: int
    parameters: HandParameters
    betas: Tensor
    object_transform: Tensor
    vertices: Tensor
    faces: Tensor

    def first(self, n: int) -> Grasps:
        """The first n of them, or all when there are fewer."""
        per_grasp = ("betas", "object_transform", "vertices", "distances")
        return replace(
            self, parameters=self.parameters.select(slice(n)), **{name: getattr(self, name)[:n] for name in per_grasp}
        )

    @property
    def units_per_metre(self) -> float:
        """How many of the mesh's units make a metre."""
        return float(np.linalg.det(self.to_object[:3, :3]) ** (-1 / 3))

    @property
    def up(self) -> np.ndarray:
        """(3,) the direction that points up in the mesh's frame, of length 1."""
        return self.to_object[2, :3] * self.units_per_metre

    def summary(self) -> str:
        """The grasps in a line for the screen."""
        return (
            f"{len(self)} grasps, thumb and a finger touch in {self.pinched.float().mean():.0%}, "
            f"deepest penetration {1000 * self.max_penetration.mean():.1f} mm on average"
        )

    def report(self) -> list[dict]:
        """One record per grasp, ready for JSON: penetration in mm, contact vertices by finger, index and seed."""
        rows = zip(
            self.max_penetration.tolist(), self.mean_penetration.tolist(), self.contact_vertices.tolist(), strict=True
        )
        return [
            {
                "index": i,
                "seed": self.seed,
                "max_penetration_mm": round(deepest * 1000, 3),
                "mean_penetration_mm": round(mean * 1000, 3),
                "contact_vertices": dict(zip((*FINGERS, "palm"), counts, strict=True)),
            }
            for i, (deepest, mean, counts) in enumerate(rows)
        ]
