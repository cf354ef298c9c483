"""The shipped grasps: one small safetensors file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandParameters
from grabnet.errors import UserError
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.io.files import existing, write_bytes
from grabnet.io.shipped import shipped

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
