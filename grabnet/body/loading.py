"""Reading hand models safely: plain arrays only, checked for shape before anything uses them."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

import numpy as np

from grabnet.errors import UserError
from grabnet.files import existing

_SHAPES = {
    "v_template": ("V", 3),
    "shapedirs": ("V", 3, "S"),
    "posedirs": ("V", 3, 135),
    "J_regressor": (16, "V"),
    "weights": ("V", 16),
    "kintree_table": (2, 16),
    "f": ("F", 3),
    "hands_components": (45, 45),
    "hands_mean": (45,),
}


def read_model(path: str | Path) -> dict[str, np.ndarray]:
    """Arrays of a hand model in MANO's schema.

    Returns:
        the schema's arrays as float32 (faces as int64 under `faces`), `parents` (16,) int64 with -1 for the root, and
        `is_right`, read off the file name as the field does.

    Raises:
        UserError: unreadable file; missing, misshapen or not finite array; faces that name no vertex.
    """
    path = existing(path, "Hand model")
    model = read_npz(path)
    check_shapes(path, model, _SHAPES)
    parents = model.pop("kintree_table")[0].astype(np.int64)
    parents[0] = -1  # stored as 2³² - 1
    faces = model.pop("f").astype(np.int64)
    if not faces.size or faces.min() < 0 or faces.max() >= len(model["v_template"]):
        raise UserError(f"{path}: its {len(faces)} faces don't name vertices 0 … {len(model['v_template']) - 1}.")
    arrays = {k: v.astype(np.float32) for k, v in model.items() if k in _SHAPES}
    return arrays | {"faces": faces, "parents": parents, "is_right": np.array("LEFT" not in path.stem.upper())}


def read_npz(path: str | Path) -> dict[str, np.ndarray]:
    """Every plain array of an `.npz`; arrays of Python objects (pickles) are refused.

    Raises:
        UserError: not an npz file, or it holds pickled objects.
    """
    try:
        archive = np.load(path, allow_pickle=False)
        if not isinstance(archive, np.lib.npyio.NpzFile):
            raise ValueError("it holds a single array")
        with archive:
            return {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, NotImplementedError, zipfile.BadZipFile, zlib.error) as error:
        if "pickle" in str(error):
            raise UserError(f"{path} holds pickled Python objects, which are not loaded: save plain arrays.") from None
        raise UserError(f"{path} is not a readable .npz file ({error}).") from None


def check_shapes(path: str | Path, arrays: dict[str, np.ndarray], shapes: dict[str, tuple[int | str, ...]]) -> None:
    """Raise a `UserError` unless each array holds finite numbers in its shape; equal letters stand for equal sizes."""
    if missing := sorted(shapes.keys() - arrays.keys()):
        raise UserError(f"{path} lacks {', '.join(missing)}: it is no hand model in MANO's schema.")
    sizes: dict[str, int] = {}
    for name, shape in shapes.items():
        actual = arrays[name].shape
        fits = len(actual) == len(shape) and all(
            n == (sizes.setdefault(s, n) if isinstance(s, str) else s) for s, n in zip(shape, actual, strict=True)
        )
        if not fits:
            expected = tuple(sizes.get(s, s) if isinstance(s, str) else s for s in shape)
            raise UserError(f"{path}: {name} has shape {actual}, expected {expected}.")
        if arrays[name].dtype.kind not in "fiu" or not np.isfinite(arrays[name]).all():
            raise UserError(f"{path}: {name} holds values that are not finite numbers.")
