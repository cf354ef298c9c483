"""The shipped grasps: one small safetensors file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors.torch import save
from torch import Tensor

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandParameters
from grabnet.errors import UserError
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.io.files import write_bytes
from grabnet.io.shipped import shipped
from grabnet.io.tensors import Shape, check_tensors, fact, read_tensors

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
_SHAPES: dict[str, Shape] = dict.fromkeys(_PER_GRASP, ("N",)) | {
    "angles": ("N", 21), "global_orient": ("N", 3), "transl": ("N", 3)
}  # fmt: skip
_NAMES = ("objects", "subjects", "genders", "kinds")
_REMEDY = "remake it with `python scripts/build_open.py grasps`"


def load_open_grasps(path: str | Path = OPEN_GRASPS) -> OpenGrasps:
    """Read the grasps that `save_open_grasps` wrote.

    Raises:
        UserError: missing or damaged file.
    """
    stored = read_tensors(path, "Grasp file", _REMEDY)
    meta = fact(stored, "grasps", {name: [str] for name in _NAMES}, _REMEDY)
    names = {name: tuple(meta.pop(name)) for name in _NAMES}
    check_tensors(stored, _SHAPES | {"betas": (len(names["subjects"]), 10)}, _REMEDY)
    tensors = {name: stored.values[name] for name in (*_SHAPES, "betas")}
    for name, of in (("object", "objects"), ("subject", "subjects"), ("kind", "kinds")):
        tensors[name] = tensors[name].long()
        if len(tensors[name]) and not 0 <= tensors[name].min() <= tensors[name].max() < len(names[of]):
            raise UserError(f"{stored.path}: {name} numbers no {name} of its {len(names[of])}: {_REMEDY}.")
    changed = {"angles": tensors["angles"].float(), "clears_table": tensors["clears_table"].bool()}
    return OpenGrasps(**names, **(tensors | changed), meta=meta)


def save_open_grasps(path: str | Path, grasps: OpenGrasps) -> None:
    """Write atomically: half precision for angles (.5 mrad), single for the rest."""
    tensors = {name: getattr(grasps, name).to(dtype).contiguous() for name, dtype in _PER_GRASP.items()}
    names = {name: getattr(grasps, name) for name in ("objects", "subjects", "genders", "kinds")}
    write_bytes(path, save(tensors | {"betas": grasps.betas}, {"grasps": json.dumps(names | grasps.meta)}))
