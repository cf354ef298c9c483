"""The shipped grasps: one small safetensors file, its provenance and its report."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import OPEN_HANDS, HandParameters
from grabnet.errors import UserError
from grabnet.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from grabnet.io.files import existing, sha256, write_bytes, write_json
from grabnet.io.provenance import provenance
from grabnet.io.shipped import shipped

if TYPE_CHECKING:
    from grabnet.open.grasps.synthesise import ObjectGrasps, SynthesisConfig

OPEN_GRASPS = shipped("assets") / "open_grasps" / "grasps.safetensors"


@dataclass(frozen=True, eq=False)
class OpenGrasps:
    """N right-hand grasps, each in the frame of its object's own mesh (metres, z up, resting on its table).

    Attributes:
        object, subject, kind: (N,) int64 indices into objects, subjects and kinds (names).
        genders: of the subjects. betas: (S, 10) their hand shapes.
        clears_table: (N,) bool, no part of hand or forearm is below the table the object rests on.
        angles: (N, 21) anatomical angles, radians. global_orient: (N, 3) axis-angle. transl: (N, 3) metres.
        meta: seed, config, and hashes of hand and meshes.
    """

    objects: tuple[str, ...]
    subjects: tuple[str, ...]
    genders: tuple[str, ...]
    kinds: tuple[str, ...]
    object: Tensor
    subject: Tensor
    kind: Tensor
    clears_table: Tensor
    angles: Tensor
    global_orient: Tensor
    transl: Tensor
    betas: Tensor
    meta: dict

    def __len__(self) -> int:
        return len(self.object)

    def parameters(self, anatomy: Anatomy, index: Tensor | slice = slice(None)) -> HandParameters:
        """The chosen grasps as parameters of the open hand shaped by their subjects' betas, object frame."""
        return HandParameters(
            axis_angle_to_matrix(self.global_orient[index]), anatomy.hand_pose(self.angles[index]), self.transl[index]
        )


_PER_GRASP = {
    "object": torch.uint8,
    "subject": torch.uint8,
    "kind": torch.uint8,
    "clears_table": torch.bool,
    "angles": torch.float16,
    "global_orient": torch.float32,
    "transl": torch.float32,
}


def load_open_grasps(path: str | Path = OPEN_GRASPS) -> OpenGrasps:
    """Read the grasps that `save_open_grasps` wrote.

    Raises:
        UserError: missing or damaged file.
    """
    path = existing(path, "Grasp file")
    try:
        with safe_open(path, "pt") as file:
            meta = json.loads(file.metadata()["grasps"])
            tensors = {name: file.get_tensor(name) for name in (*_PER_GRASP, "betas")}
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise UserError(
            f"{path} is no grasp file ({error}); remake it with `python scripts/build_open.py grasps`."
        ) from None
    names = {name: tuple(meta.pop(name)) for name in ("objects", "subjects", "genders", "kinds")}
    for name in ("object", "subject", "kind"):
        tensors[name] = tensors[name].long()
    return OpenGrasps(**names, **(tensors | {"angles": tensors["angles"].float()}), meta=meta)


def save_open_grasps(path: str | Path, grasps: OpenGrasps) -> None:
    """Write atomically: half precision for angles (.5 mrad), single for the rest."""
    tensors = {name: getattr(grasps, name).to(dtype).contiguous() for name, dtype in _PER_GRASP.items()}
    names = {name: getattr(grasps, name) for name in ("objects", "subjects", "genders", "kinds")}
    write_bytes(path, save(tensors | {"betas": grasps.betas}, {"grasps": json.dumps(names | grasps.meta)}))


def collect(found: Sequence[ObjectGrasps], betas: Tensor, config: SynthesisConfig, seed: int) -> OpenGrasps:
    """One `OpenGrasps` of the `ObjectGrasps` of all objects, sorted by object name."""
    # Here: reading grasps shouldn't wait for what makes them.
    from grabnet.open.grasps.synthesise import GENDERS, KIND_NAMES, SUBJECTS

    found = sorted(found, key=lambda o: o.name)
    number = torch.cat([torch.full((len(o.kind),), i) for i, o in enumerate(found)])
    return OpenGrasps(
        tuple(o.name for o in found),
        SUBJECTS,
        GENDERS,
        KIND_NAMES,
        number,
        torch.cat([o.subject for o in found]),
        torch.cat([o.kind for o in found]),
        torch.cat([o.clears_table for o in found]),
        torch.cat([o.pose.angles for o in found]),
        matrix_to_axis_angle(torch.cat([o.pose.rotation for o in found])),
        torch.cat([o.transl for o in found]),
        betas,
        {
            "seed": seed,
            "hand_sha256": sha256(OPEN_HANDS / "MANO_RIGHT.npz"),
            "object_sha256": {o.name: o.mesh_sha256 for o in found},
            "config": asdict(config),
        },
    )


def write_asset(
    path: Path, found: Sequence[ObjectGrasps], betas: Tensor, config: SynthesisConfig, seed: int
) -> OpenGrasps:
    """Write the grasp file and beside it `grasps.json` (provenance) and `report.json` (a row per object)."""
    grasps = collect(found, betas, config, seed)
    save_open_grasps(path, grasps)
    write_json(
        path.with_suffix(".json"),
        provenance(
            file=path.name,
            sha256=sha256(path),
            grasps=len(grasps),
            source="synthesised by scripts/build_open.py grasps from the open hand and open objects; nothing recorded",
            licence="CC0-1.0",
            **grasps.meta,
        ),
    )
    write_json(path.with_name("report.json"), {o.name: o.report for o in sorted(found, key=lambda o: o.name)})
    return grasps
