"""Triangle meshes: the one form in which objects move through the code, and their reading and writing."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh

from grabnet.errors import UserError, printable
from grabnet.geometry.formats.geometry import MAX_FACES
from grabnet.geometry.formats.reading import read_geometry
from grabnet.geometry.repair.mending import mended
from grabnet.geometry.repair.orientation import UndecidedError
from grabnet.io.files import existing, sha256, write_bytes

# How many times its size a mesh may lie from its origin: its coordinates have 7 digits.
MAX_OFFSET = 1000


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh in its own frame.

    vertices: (V, 3) float32. faces: (F, 3) int32, counter-clockwise seen from outside. repairs: what was mended for
    that, a phrase for each kind.
    """

    vertices: np.ndarray
    faces: np.ndarray
    repairs: tuple[str, ...] = ()

    def __post_init__(self):
        for name, dtype in (("vertices", np.float32), ("faces", np.int32)):
            array = np.array(getattr(self, name), dtype=dtype, order="C")
            array.setflags(write=False)  # the cached properties below hold for the life of the mesh
            object.__setattr__(self, name, array)

    @cached_property
    def sha256(self) -> str:
        """Hex digest of vertices and faces: equal for equal geometry, wherever it was read from."""
        return sha256(self.vertices, self.faces)

    @cached_property
    def centroid(self) -> np.ndarray:
        """(3,) mean of the vertices: the origin of the frame grasps are learned in (ref. 3)."""
        return self.vertices.mean(0, dtype=np.float64).astype(np.float32)

    @cached_property
    def surface_centre(self) -> np.ndarray:
        """(3,) mean of the surface by area: the mean vertex of a mesh of even faces, whatever the faces."""
        corners = self.triangles.astype(np.float64)
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        return (area @ corners.mean(1) / area.sum()).astype(np.float32)

    @property
    def bounds(self) -> np.ndarray:
        """(2, 3) lowest and highest corner."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])

    @property
    def extents(self) -> np.ndarray:
        """(3,) sides of the bounding box."""
        return np.ptp(self.vertices, axis=0)

    @property
    def triangles(self) -> np.ndarray:
        """(F, 3, 3) corners of each face."""
        return self.vertices[self.faces]

    @cached_property
    def volume(self) -> float:
        """Enclosed volume; negative when the faces look inward. Of an open mesh: closed towards its centroid."""
        a, b, c = np.moveaxis(self.triangles.astype(np.float64) - self.centroid, 1, 0)
        return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)

    @cached_property
    def is_closed(self) -> bool:
        """Whether every edge joins two faces that run along it in opposite directions."""
        start, end = self.faces.astype(np.int64), np.roll(self.faces, -1, axis=1).astype(np.int64)
        n = len(self.vertices)
        forward, backward = np.sort((start * n + end).ravel()), np.sort((end * n + start).ravel())
        return bool((forward == backward).all() and (np.diff(forward) > 0).all())

    def trimesh(self) -> trimesh.Trimesh:
        """The same mesh for trimesh, with vertices and faces untouched."""
        return trimesh.Trimesh(self.vertices, self.faces, process=False)

    def transformed(self, matrix: np.ndarray) -> Mesh:
        """Moved by a (4, 4) affine matrix acting on column vectors."""
        matrix = np.asarray(matrix, dtype=np.float64)
        return Mesh(self.vertices @ matrix[:3, :3].T + matrix[:3, 3], self.faces)

    def subdivided(self) -> Mesh:
        """Each face cut into four at the middles of its sides.

        The new vertices follow the old ones, in the order of the pairs of vertices that they lie between.
        """
        sides = np.sort(self.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        pairs, number = np.unique(sides, axis=0, return_inverse=True)
        ab, bc, ca = (len(self.vertices) + number.reshape(-1, 3)).T
        a, b, c = self.faces.T
        faces = np.stack([a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca], 1).reshape(-1, 3)
        return Mesh(np.concatenate([self.vertices, self.vertices[pairs].mean(1)]), faces)

    def sample_surface(self, n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) points spread evenly by area and the (n, 3) unit normals of their faces, float32."""
        rng = np.random.default_rng(seed)
        corners = self.triangles.astype(np.float64)
        edge_u, edge_v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        normals = np.cross(edge_u, edge_v)
        doubled_area = np.linalg.norm(normals, axis=1)
        face = rng.choice(len(corners), n, p=doubled_area / doubled_area.sum())
        u, v = rng.random((2, n, 1))
        u, v = np.where(u + v > 1, (1 - u, 1 - v), (u, v))  # fold the parallelogram onto the triangle
        points = corners[face, 0] + u * edge_u[face] + v * edge_v[face]
        return points.astype(np.float32), (normals[face] / doubled_area[face, None]).astype(np.float32)


def vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return (..., V) float64: a third of the area of the faces (F, 3) around each of vertices (..., V, 3)."""
    a, b, c = np.moveaxis(np.asarray(vertices, np.float64)[..., faces, :], -2, 0)
    third = np.linalg.norm(np.cross(b - a, c - a), axis=-1) / 6
    areas = np.zeros(vertices.shape[:-1])
    flat, shares = areas.reshape(-1, areas.shape[-1]), third.reshape(-1, third.shape[-1])
    for row, share in zip(flat, shares, strict=True):
        row += np.bincount(faces.ravel(), np.repeat(share, 3), minlength=len(row))
    return areas


def load_mesh(path: str | Path, weld: bool = True, mend: bool = True) -> Mesh:
    """Read a mesh as `read_mesh` does, with a warning that says what was mended."""
    mesh = read_mesh(path, weld, mend)
    if mesh.repairs:
        warnings.warn(printable(f"{path} was mended: {'; '.join(mesh.repairs)}."), stacklevel=2)
    return mesh


def read_mesh(path: str | Path, weld: bool = True, mend: bool = True) -> Mesh:
    """Read an obj, ply, stl, off, glb or gltf file, in the file's own frame and units (see `load_object`).

    Scenes are flattened with their transforms. Only geometry is read: no materials, nothing outside the file's folder.

    Args:
        weld: merge exactly equal vertices (STL stores each face's corners by themselves) and drop those that no face
            uses, in file order otherwise. Pass False where other data counts on the file's vertex numbers.
        mend: make faces agree on which side is inside (`with_sides`). Pass False where only vertices count, or faces
            are compared.

    Raises:
        UserError: missing, of an unknown or wrong format, unreadable, no faces, not finite, no area, too many faces,
            too far from its origin, faces that do not tell which side is inside.
    """
    path = existing(path, "Mesh")
    vertices, faces = read_geometry(path)
    _check(path, vertices, faces)
    check_offset(vertices, faces, path)
    mesh = Mesh(*_welded(vertices, faces)) if weld else Mesh(vertices, faces)
    if not np.linalg.norm(trimesh.triangles.cross(mesh.triangles.astype(np.float64)), axis=1).sum() > 0:
        raise UserError(
            f"{path} has zero area: its {len(faces)} faces are all lines or points; export a solid surface."
        )
    return with_sides(mesh, path) if mend else mesh


def with_sides(mesh: Mesh, name: str | Path) -> Mesh:
    """The mesh with faces that agree on which side is inside: double ones dropped, others turned; said in `repairs`.

    Raises:
        UserError: a surface that does not tell.
    """
    try:
        faces, repairs = mended(mesh.vertices, mesh.faces)
    except UndecidedError:
        raise UserError(
            f"{name} does not tell which side of its faces is inside: make a solid of it, or recalculate its normals."
        ) from None
    return replace(mesh, faces=faces, repairs=(*mesh.repairs, *repairs)) if repairs else mesh


def check_offset(vertices: np.ndarray, faces: np.ndarray, name: str | Path) -> None:
    """Raise a `UserError` where faces lie so far from the origin that single precision spoils their shape."""
    corners = vertices[np.unique(faces)].astype(np.float64)
    low, high = corners.min(0), corners.max(0)
    offset, size = np.linalg.norm((low + high) / 2), (high - low).max()
    if offset > MAX_OFFSET * size > 0:
        raise UserError(
            f"{name} lies {offset:.4g} from its origin, {offset / size:,.0f} times its size; more than {MAX_OFFSET:,} "
            "times leaves too few digits for its shape: move it to the origin."
        )


def save_mesh(path: str | Path, mesh: Mesh) -> None:
    """Write `mesh` in the format of the file's suffix, in the mesh's own frame, atomically."""
    path = Path(path)
    data = mesh.trimesh().export(file_type=path.suffix.lower().lstrip("."))
    write_bytes(path, data.encode() if isinstance(data, str) else data)


def _check(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    if not len(faces):
        raise UserError(f"{path} has {len(vertices)} vertices but no faces: a point cloud must be meshed first.")
    if len(faces) > MAX_FACES:
        raise UserError(f"{path} has {len(faces):,} faces; simplify it to at most {MAX_FACES:,} (20,000 are plenty).")
    if bad := int((~(np.abs(vertices) < np.finfo(np.float32).max)).any(1).sum()):
        raise UserError(f"{path} has {bad} vertices that are NaN or infinite: repair or export it again.")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise UserError(f"{path} has faces that name vertices beyond the {len(vertices)} it holds: export it again.")


def _welded(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Equal vertices made one and unused ones dropped, in order of first appearance; collapsed faces dropped."""
    vertices = np.ascontiguousarray(vertices, np.float32) + 0.0  # -0 and 0 are the same place
    _, first, same = np.unique(vertices.view("V12").ravel(), return_index=True, return_inverse=True)
    faces = first[same[faces]]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    used = np.unique(faces)
    return vertices[used], np.searchsorted(used, faces)
