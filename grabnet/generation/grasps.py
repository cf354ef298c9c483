"""Grasps: hands on one object, in the frame and units of the object's own mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from grabnet.body.anatomy import FINGERS
from grabnet.body.hand import HandParameters
from grabnet.contact import contacts
from grabnet.contact.contacts import Contacts
from grabnet.errors import UserError
from grabnet.generation import ranking
from grabnet.generation.formats import FORMATS, MESH_NAMES
from grabnet.generation.ranking import Ranked
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.object_mesh import ObjectMesh
from grabnet.geometry.rotations import matrix_to_axis_angle
from grabnet.grasping import measures
from grabnet.grasping.measures import GraspMeasures
from grabnet.io.files import filling, write_json
from grabnet.io.state import read_json

RECORD = "grasps.json"
# The files of a folder of results. The last one is written last: where it lies, the others are complete.
RESULTS = (
    *(f"meshes/{name}" for name in MESH_NAMES),
    *(f"contact/{node}_[0-9][0-9][0-9]*.ply" for node in ("object", "hand")),
    *("contact.npz", "index.html", "contact_sheet.png", "grasps.npz"),
    RECORD,
)


def record_of(folder: Path) -> dict[str, Any]:
    """What a folder says of its results; empty where it says nothing."""
    try:
        return read_json(folder / RECORD, {"mesh?": str}, "sample again")
    except UserError:
        return {}


def has_results(folder: Path) -> bool:
    """Whether a folder holds grasps that were written by `Grasps.save`."""
    return {"grasps", "definitions"} <= record_of(folder).keys()


@dataclass(frozen=True, eq=False, kw_only=True)
class Grasps:
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
            as the networks saw the object, origin at its centre (`Conventions`).
        vertices: (N, V, 3) hands in the mesh's frame and units. faces: (F, 3), outward.
        contacts: of the hands with the mesh; distances are exact within 1 cm of it.
        measures: of the same, beyond contact.
        ranked: why these were kept; None where they were not chosen from more.
        remarks: what was mended of the mesh, and what about it makes grasps doubtful.
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
    contacts: Contacts
    measures: GraspMeasures
    ranked: Ranked | None = None
    remarks: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.vertices)

    def __repr__(self) -> str:
        return f"<{self.summary()}; {self.side} hands, seed {self.seed}>"

    def first(self, n: int) -> Grasps:
        """The first n of them, or all when there are fewer."""
        per_grasp = ("betas", "object_transform", "vertices")
        return replace(
            self,
            parameters=self.parameters.select(slice(n)),
            contacts=replace(self.contacts, distances=self.contacts.distances[:n]),
            measures=self.measures.select(slice(n)),
            ranked=self.ranked and self.ranked.first(n),
            **{name: getattr(self, name)[:n] for name in per_grasp},
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
        pinched, pierced = self.contacts.pinched.float().mean(), self.measures.pierced.float().mean()
        deepest, through = 1000 * self.contacts.max_penetration.mean(), self.measures.through_mm.mean()
        remarks = f" (mesh: {'; '.join(self.remarks)})" if self.remarks else ""
        return (
            f"{len(self)} grasps, thumb and a finger touch in {pinched:.0%}, {pierced:.0%} go through the object; on "
            f"average {deepest:.1f} mm deep at the deepest vertex and {through:.1f} mm through walls{remarks}"
        )

    def report(self) -> list[dict[str, Any]]:
        """One record per grasp, ready for JSON: index, seed, penetration, measures, contact vertices by finger; and by
        what score it was chosen, where there were several candidates."""
        rows = zip(
            self.contacts.max_penetration.tolist(),
            self.contacts.mean_penetration.tolist(),
            self.contacts.contact_vertices.tolist(),
            self.measures.report(),
            strict=True,
        )
        ranked = self.ranked.report() if self.ranked else [{}] * len(self)
        return [
            {
                "index": i,
                "seed": self.seed,
                "max_penetration_mm": round(deepest * 1000, 3),
                "mean_penetration_mm": round(mean * 1000, 3),
                **measured,
                "contact_vertices": dict(zip((*FINGERS, "palm"), counts, strict=True)),
                **ranked[i],
            }
            for i, (deepest, mean, counts, measured) in enumerate(rows)
        ]

    def save(self, folder: str | Path, formats: Sequence[str] = ("glb",), **record: Any) -> None:
        """Write grasps.npz, grasps.json and meshes/ into `folder`, in place of earlier ones, all or nothing.

        Args:
            folder: earlier results in it give way, other files stay as they are.
            formats: of the meshes, any of `FORMATS`; all lie in the frame and units of the object's mesh.
            record: facts for grasps.json, ready for JSON, beside the list `grasps` and the definitions of its numbers.

        Raises:
            UserError: an unknown format, or a folder with files of these names that are not earlier results.
        """
        with filling(folder, RESULTS, has_results) as temporary:
            self.write(temporary, formats, record)

    def write(self, folder: Path, formats: Sequence[str], record: Mapping[str, Any]) -> None:
        """Write the same files into an empty folder."""
        if unknown := [name for name in formats if name not in FORMATS]:
            raise UserError(f"format is '{unknown[0]}'; it can be any of {', '.join(FORMATS)}.")
        np.savez(folder / "grasps.npz", **self.arrays())
        placed = ObjectMesh(self.mesh, self.to_object)
        for name in formats:
            (folder / "meshes").mkdir(exist_ok=True)
            FORMATS[name](folder / "meshes", placed, self.vertices.numpy(), self.faces.numpy())
        facts = {
            "remarks": list(self.remarks),
            "definitions": contacts.DEFINITIONS | measures.DEFINITIONS | ranking.DEFINITIONS,
        }
        facts["contact_distance"] = self.contacts.contact_distance
        write_json(folder / RECORD, {**record, **facts, "grasps": self.report()})

    def arrays(self) -> dict[str, np.ndarray]:
        """What grasps.npz holds, as the field's hand models take it (metres, radians, along the axes of the mesh).

        global_orient (N, 3) and hand_pose (N, 45) axis-angle (flat_hand_mean), transl (N, 3), betas (N, n), side,
        units_per_metre () by which posed vertices are multiplied to lie in the mesh's units, object_transform (N, 4, 4)
        from the mesh's frame to the world each grasp was made in, seed ().
        """
        pose = self.parameters
        tensors = {
            "global_orient": matrix_to_axis_angle(pose.global_orient),
            "hand_pose": matrix_to_axis_angle(pose.hand_pose).flatten(1),
            "transl": pose.transl,
            "betas": self.betas,
            "object_transform": self.object_transform,
        }
        return {name: value.numpy() for name, value in tensors.items()} | {
            "side": np.array(self.side),
            "units_per_metre": np.float64(self.units_per_metre),
            "seed": np.int64(self.seed),
        }
