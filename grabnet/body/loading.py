"""Reading body models safely: plain arrays only, checked for shape before anything uses them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from grabnet.errors import UserError
from grabnet.io.files import existing
from grabnet.io.npz import read_npz
from grabnet.io.pickles import read_pickle
from grabnet.io.tensors import Shape, check_shapes

Shapes = Mapping[str, Shape]

_SKINNED: Shapes = {
    "v_template": ("V", 3),
    "shapedirs": ("V", 3, "S"),
    "posedirs": ("V", 3, "P"),
    "J_regressor": ("J", "V"),
    "weights": ("V", "J"),
    "kintree_table": (2, "J"),
    "f": ("F", 3),
}
# Hands in MANO's schema: 16 joints.
HAND_SHAPES: Shapes = _SKINNED | {"kintree_table": (2, 16), "hands_components": (45, 45), "hands_mean": (45,)}
# Whole bodies in SMPL-X's: 55 joints, left (l) and right (r) hand poses.
BODY_SHAPES: Shapes = _SKINNED | {
    "kintree_table": (2, 55),
    "hands_componentsl": (45, 45),
    "hands_componentsr": (45, 45),
    "hands_meanl": (45,),
    "hands_meanr": (45,),
}


def read_model(path: str | Path, shapes: Shapes, schema: str) -> dict[str, np.ndarray]:
    """Arrays of a body model, from the `.npz` or `.pkl` that its authors publish.

    Args:
        path: of the file; pickles are decoded without running anything (`grabnet.io.pickles`).
        shapes: `HAND_SHAPES` or `BODY_SHAPES`.
        schema: its name, for messages.

    Returns:
        the schema's arrays as float32 (faces as int64 under `faces`) and `parents` (J,) int64 with -1 for the root.

    Raises:
        UserError: unreadable file; missing, misshapen or not finite array; faces that name no vertex; parents that
            don't come before their children.
    """
    path = existing(path, f"{schema} model")
    model = read_pickle(path) if path.suffix == ".pkl" else read_npz(path)
    if not isinstance(model, dict):
        raise UserError(f"{path} holds one {type(model).__name__}: it is no model in {schema}'s schema.")
    if missing := sorted(shapes.keys() - model.keys()):
        raise UserError(f"{path} lacks {', '.join(missing)}: it is no model in {schema}'s schema.")
    model = {name: np.asarray(model[name]) for name in shapes}
    n_joints = shapes["kintree_table"][1]
    check_shapes(path, model, {**shapes, "posedirs": ("V", 3, 9 * (n_joints - 1))})
    parents = model.pop("kintree_table")[0].astype(np.int64)
    parents[0] = -1  # stored as 2³² - 1
    if not ((parents[1:] >= 0) & (parents[1:] < np.arange(1, n_joints))).all():
        raise UserError(f"{path}: its kintree_table has joints whose parents don't come before them.")
    faces = model.pop("f").astype(np.int64)
    if not faces.size or faces.min() < 0 or faces.max() >= len(model["v_template"]):
        raise UserError(f"{path}: its {len(faces)} faces don't name vertices 0 … {len(model['v_template']) - 1}.")
    return {k: v.astype(np.float32) for k, v in model.items()} | {"faces": faces, "parents": parents}
