"""Grasps: hands on one object, in the frame and units of the object's own mesh."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from torch import Tensor

from grabnet.body.anatomy import FINGERS
from grabnet.body.hand import HandParameters
from grabnet.contact.contacts import Contacts
from grabnet.geometry.mesh import Mesh

# What the numbers of a report are, kept beside them.
DEFINITIONS = {
    "max_penetration_mm": "depth of the deepest hand vertex inside the object",
    "mean_penetration_mm": "mean depth of those hand vertices that are inside the object, 0 where none is",
    "contact_vertices": "hand vertices inside the object or nearer to its surface than 4.5 mm",
    "distance": "signed distance to the mesh itself, exact (no grid); inside is where the winding number exceeds 1/2",
}


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
