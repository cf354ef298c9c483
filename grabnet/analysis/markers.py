"""Where motion-capture markers were on objects."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from grabnet.errors import UserError
from grabnet.geometry.mesh import load_mesh
from grabnet.io.files import existing
from grabnet.io.npz import read_npy
from grabnet.mosh.layouts import read_object_layouts

# Metres around an object that a marker's middle lies within; those that don't are in other units or another frame.
_SLACK = 0.02


def read_markers(path: str, objects: Mapping[str, Path], field: str) -> dict[str, np.ndarray]:
    """Positions (M, 3) of the markers of each object that has any, metres in its own frame.

    Args:
        path: a layout of objects as MoSh reads it (YAML); or a folder of `<object>.npy`, each of positions (M, 3)
            or of the numbers (M,) of the mesh's vertices that the markers are on.
        objects: mesh file of each object; markers of others are left out.
        field: of the config, that names the path, for errors.

    Raises:
        UserError: no such path, not in this form, or markers that are not on their object.
    """
    place = existing(path, f"Markers ({field})")
    if place.is_dir():
        files = {file.stem: file for file in sorted(place.glob("*.npy"))}
        found = {name: _read(file, objects[name]) for name, file in files.items() if name in objects}
    else:
        layouts = read_object_layouts(place)
        found = {name: layout.positions for name, layout in layouts.items() if name in objects}
    if not found:
        raise UserError(
            f"{place} holds markers of none of the {len(objects)} objects: give {field} another path, or {field}=null."
        )
    for name, markers in found.items():
        vertices = load_mesh(objects[name], weld=False).vertices
        outside = np.maximum(vertices.min(0) - markers, markers - vertices.max(0)).max()
        if not outside <= _SLACK:
            raise UserError(
                f"{place}: a marker of {name} is {1000 * outside:.0f} mm off the object: metres in the object's frame "
                f"are needed; or give {field}=null."
            )
    return found


def _read(file: Path, mesh: Path) -> np.ndarray:
    array = read_npy(file)
    if isinstance(array, np.ndarray) and len(array.shape) == 1 and array.dtype.kind in "iu" and len(array):
        vertices = load_mesh(mesh, weld=False).vertices
        if array.min() < 0 or array.max() >= len(vertices):
            raise UserError(f"{file} names a vertex that {mesh.name} does not have; it has {len(vertices)}.")
        return vertices[array]
    is_array = isinstance(array, np.ndarray) and array.ndim == 2 and array.shape[1] == 3 and array.dtype.kind == "f"
    if not (is_array and len(array) and np.isfinite(array).all()):
        raise UserError(
            f"{file} holds no markers: positions (M, 3) in metres, or numbers (M,) of the mesh's vertices, are needed."
        )
    return array
