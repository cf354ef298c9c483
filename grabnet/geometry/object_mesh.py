"""The mesh of an object to grasp, and how its file's frame and units become metres with z up."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from grabnet.errors import UserError
from grabnet.geometry.gaps import widest_gap
from grabnet.geometry.mesh import Mesh, check_offset, read_mesh, with_sides

# The axis that points up, where a format's specification says so; every other file is taken as z-up.
FORMAT_UP = {".gltf": "y", ".glb": "y"}
# Metres between parts from which on they are said to lie apart: a hand about the middle of all hardly reaches one.
FAR_PARTS = 0.05


@dataclass(frozen=True, eq=False)
class ObjectMesh:
    """A mesh in its own frame and units, and the way from there to metres.

    Attributes:
        mesh: as in its file.
        to_object: (4, 4) float64 similarity from the mesh's frame and units to metres, z up.
        remarks: what was mended of it, and what about it makes grasps doubtful.
    """

    mesh: Mesh
    to_object: np.ndarray
    remarks: tuple[str, ...] = ()

    @cached_property
    def solid(self) -> Mesh:
        """The mesh in metres, z up."""
        return self.mesh.transformed(self.to_object)


def load_object(
    mesh: Mesh | str | Path,
    scale: float = 1.0,
    up: str | None = None,
    max_size: float = 0.4,
    min_size: float = 0.01,
    to_object: np.ndarray | None = None,
) -> ObjectMesh:
    """An object to grasp, from a mesh or from the file of one.

    Args:
        mesh: the mesh, or an obj, ply, stl, off, glb or gltf file. Faces that disagree on which side is inside are
            mended in either.
        scale: metres per unit of the mesh: 0.001 for millimetres.
        up: the axis of the mesh that points up, "x", "y" or "z"; when omitted, y for a glTF file as its specification
            has it, else z.
        max_size: metres, of the longest side; a larger object is probably in other units, and is refused.
        min_size: metres, likewise.
        to_object: (4, 4) from the mesh's frame and units to metres, z up, in place of scale and up.

    Raises:
        UserError: an unreadable file, an unknown axis, a size out of bounds, a to_object that is no similarity, a place
            too far from the origin, or faces that do not tell which side is inside.
    """
    name = "The mesh" if isinstance(mesh, Mesh) else mesh
    if to_object is None:
        to_object = file_to_object("" if isinstance(mesh, Mesh) else mesh, scale, up)
    to_object = _similarity(to_object)
    if isinstance(mesh, Mesh):
        check_offset(mesh.vertices, mesh.faces, name)
        mesh = with_sides(mesh, name)
    else:
        mesh = read_mesh(mesh)
    corners = mesh.vertices.astype(np.float64) @ to_object[:3, :3].T + to_object[:3, 3]
    check_offset(corners, mesh.faces, name)
    loaded = ObjectMesh(mesh, to_object)
    gap = widest_gap(loaded.solid)
    apart = (f"parts of it lie {_length(gap)} apart, and hands go to the middle of all",) if gap > FAR_PARTS else ()
    check_size(loaded.solid, name, max_size, min_size)
    return replace(loaded, remarks=mesh.repairs + apart)


def _length(metres: float) -> str:
    return f"{metres:,.0f} m" if metres >= 1 else f"{100 * metres:.2g} cm"


def _similarity(values: object) -> np.ndarray:
    """(4, 4) float64 matrix; a `UserError` for one that is no rigid motion times a scale."""
    try:
        matrix = np.asarray(values)
    except (ValueError, TypeError, RuntimeError):  # ragged lists, tensors elsewhere or with gradients
        matrix = np.empty(0)
    if matrix.dtype.kind in "fiu" and matrix.shape == (4, 4) and np.isfinite(matrix).all():
        matrix = matrix.astype(np.float64)
        linear = matrix[:3, :3] / (np.abs(matrix[:3, :3]).max() or 1.0)  # of any scale without overflow
        det = max(np.linalg.det(linear), 1e-9)  # nothing of a smaller one scales all axes alike
        alike = np.abs(linear @ linear.T / det ** (2 / 3) - np.eye(3)).max() < 1e-4
        if alike and (matrix[3] == [0, 0, 0, 1]).all():
            return matrix
    raise UserError(
        "to_object is no rotation times a scale, with a shift: it must be (4, 4), finite, turn without mirroring, and "
        "scale all axes alike."
    )


def file_to_object(path: str | Path, scale: float = 1.0, up: str | None = None) -> np.ndarray:
    """(4, 4) matrix from the file's frame and units to the object frame, metres and z up.

    Args:
        scale: metres per unit of the file.
        up: the file's axis that points up, "x", "y" or "z"; when omitted, y for glTF by its specification, else z.

    Raises:
        UserError: a scale that is no positive number, or an unknown axis.
    """
    if not (math.isfinite(scale) and scale > 0):
        raise UserError(f"scale is {scale}; it must be a positive number of metres per unit of the mesh.")
    up = up or FORMAT_UP.get(Path(path).suffix.lower(), "z")
    if up not in ("x", "y", "z"):
        raise UserError(f"up is '{up}'; it can be x, y or z.")
    matrix = np.eye(4)
    # A cyclic exchange would carry up to z too, but the least turn keeps the remaining axis where it was.
    matrix[:3, :3] = {
        "x": [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        "y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
        "z": np.eye(3),
    }[up]
    matrix[:3, :3] *= scale
    return matrix


def check_size(mesh: Mesh, name: str | Path, largest: float = 0.4, smallest: float = 0.01) -> None:
    """Raise a `UserError` suggesting `scale=` where the largest side of a mesh, in metres, is beyond these bounds.

    Args:
        largest, smallest: metres; most meshes beyond them are in other units, and no hand takes the rest.
    """
    side = float(mesh.extents.max())
    if smallest <= side <= largest:
        return
    units = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254, "decimetres": 0.1}
    fits = {unit: factor for unit, factor in units.items() if 0.02 <= side * factor <= largest}
    fitting = [f"scale={factor} if it is in {unit}" for unit, factor in fits.items()]
    remedy = " or ".join(fitting) if fitting else "scale=<metres per unit of the file>"
    bound = f"larger than {largest * 100:g} cm" if side > largest else f"smaller than {smallest * 100:g} cm"
    own = f"max_size={math.ceil(100 * side) / 100:g}" if side > largest else "min_size=0"
    raise UserError(
        f"{name} has a largest side of {side:.4g}, {bound} when read as metres: pass {remedy}, or {own} if it is so."
    )
