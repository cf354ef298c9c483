"""Which voxels lie inside a mesh, exactly: their centres are tested by winding number, along whole columns at once.

Voxel (i, j, k) has its centre at `spacing * (i + 1/2, j + 1/2, k + 1/2)` of the mesh's own frame: voxels of meshes in
one frame are the same voxels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery

# More columns and voxels than this are not held at once.
_CHUNK = 1 << 22
# Most voxels of a bounding box that are asked for one by one (open meshes).
_MOST_QUERIED = 1 << 26
# A column and a height in one integer: heights count from here, and are below twice of it.
_MIDDLE = 1 << 19


@dataclass(frozen=True, eq=False)
class Runs:
    """Voxels as runs along z, ordered by column and height; no two overlap.

    column: (R, 2) int64, (i, j). first, last: (R,) int64, lowest and highest k of the run, both within.
    """

    column: np.ndarray
    first: np.ndarray
    last: np.ndarray

    def __len__(self) -> int:
        """How many voxels these are."""
        return int((self.last - self.first + 1).sum())

    def shared(self, other: Runs) -> int:
        """How many voxels are in both."""
        if not len(self.first) or not len(other.first):
            return 0
        start = _keys(self.column, self.first)
        length = self.last - self.first + 1
        before = np.concatenate([[0], length.cumsum()])

        def below(keys: np.ndarray) -> np.ndarray:
            """How many of these voxels come before `keys` in the order of columns and heights."""
            run = np.searchsorted(start, keys, "right") - 1
            within = np.clip(keys - start[run], 0, length[run])
            return np.where(run < 0, 0, before[run] + within)

        low, high = _keys(other.column, other.first), _keys(other.column, other.last + 1)
        return int((below(high) - below(low)).sum())


@dataclass(frozen=True, eq=False)
class RayCrossings:
    """Where vertical lines through voxel centres pass the surface, ordered by column and height.

    column: (C, 2) int64. height: (C,) metres or other units. winding: (C,) by how much the winding number rises there.
    """

    column: np.ndarray
    height: np.ndarray
    winding: np.ndarray
    spacing: float

    @classmethod
    def of(cls, vertices: np.ndarray, faces: np.ndarray, spacing: float) -> RayCrossings:
        """Of a closed mesh: vertices (V, 3), faces (F, 3), which may overlap itself and may face inwards as a whole."""
        # Centres on whole numbers.
        points = np.asarray(vertices, np.float64) / spacing - 0.5
        faces = np.asarray(faces, np.int64)
        pieces = [_rasterised(points, part) for part in _portions(points, faces)]
        column, height, winding = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
        a, b, c = np.moveaxis(points[faces], 1, 0)
        outward = np.einsum("fi,fi->", a - points.mean(0), np.cross(b - a, c - a)) >= 0
        order = np.lexsort((height, column[:, 1], column[:, 0]))
        column, height, winding = column[order], height[order], winding[order] * (1 if outward else -1)
        # A line along a wall may by rounding pass only the floor: it has no inside to speak of.
        starts = np.ones(len(column), bool)
        starts[1:] = (column[1:] != column[:-1]).any(1)
        number = starts.cumsum() - 1
        whole = (np.bincount(number, winding, minlength=1) == 0)[number] if len(number) else starts
        return cls(column[whole], height[whole], winding[whole], spacing)

    def inside(self, at_least: int = 1) -> Runs:
        """Voxels about which the surface winds at least so many times: 1 inside; 2 where it overlaps itself."""
        if not len(self.height):
            return Runs(self.column, self.column[:, 0], self.column[:, 0])
        depth = self.winding.cumsum()  # 0 again at the end of each column
        follows = (self.column[1:] == self.column[:-1]).all(1)
        # The least whole number not below a height is the first voxel above it.
        level = np.ceil(self.height).astype(np.int64)
        within = (depth[:-1] >= at_least) & follows & (level[1:] > level[:-1])
        return _joined(self.column[:-1][within], level[:-1][within], level[1:][within] - 1)


def inside(mesh: Mesh, spacing: float, query: MeshQuery | None = None) -> Runs:
    """Voxels inside an object's mesh, by winding number as `MeshQuery` has it: of open meshes too.

    Args:
        query: of the mesh, where there is one already; only open meshes need it.

    Raises:
        UserError: an open mesh so large that its voxels cannot be gone through.
    """
    if mesh.is_closed:
        return RayCrossings.of(mesh.vertices, mesh.faces, spacing).inside()
    low, high = np.floor(mesh.bounds / spacing).astype(np.int64)
    sides = high - low + 1
    if sides.prod() > _MOST_QUERIED:
        raise UserError(
            f"A mesh with openings of {' × '.join(f'{100 * s:.0f}' for s in mesh.extents)} cm has too many voxels of "
            f"{1000 * spacing:g} mm: close it, or scale it to metres."
        )
    query = query or MeshQuery(mesh)
    layers = np.arange(low[0], high[0] + 1)
    j, k = np.meshgrid(np.arange(low[1], high[1] + 1), np.arange(low[2], high[2] + 1), indexing="ij")
    found = []
    for part in np.array_split(layers, max(1, int(sides.prod() // _CHUNK))):
        index = np.stack(np.broadcast_arrays(part[:, None, None], j[None], k[None]), -1)
        points = torch.from_numpy(((index.reshape(-1, 3) + 0.5) * spacing).astype(np.float32))
        found.append(index.reshape(-1, 3)[query.signed_distance(points).numpy() < 0])
    index = np.concatenate(found)
    return _joined(index[:, :2], index[:, 2], index[:, 2])


def _keys(column: np.ndarray, height: np.ndarray) -> np.ndarray:
    """(N,) whole numbers in the order of columns and heights."""
    return ((column[:, 0] + _MIDDLE) << 40) + ((column[:, 1] + _MIDDLE) << 20) + height + _MIDDLE


def _joined(column: np.ndarray, first: np.ndarray, last: np.ndarray) -> Runs:
    """Runs made of pieces in order, of which some follow each other directly."""
    if not len(first):
        return Runs(column, first, last)
    starts = np.ones(len(first), bool)
    starts[1:] = (column[1:] != column[:-1]).any(1) | (first[1:] != last[:-1] + 1)
    ends = np.append(starts[1:], True)
    return Runs(column[starts], first[starts], last[ends])


def _portions(points: np.ndarray, faces: np.ndarray) -> list[np.ndarray]:
    """The faces in portions, each of which covers not too many columns."""
    plane = points[faces][..., :2]
    area = (np.floor(plane.max(1)) - np.ceil(plane.min(1)) + 1).clip(0).prod(1)
    parts = np.array_split(faces, max(1, int(area.sum() // _CHUNK) + 1))
    return [part for part in parts if len(part)]


def _rasterised(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns, heights and winding of all passages of vertical lines through whole numbers through the faces.

    A line through an edge passes exactly one of the two faces at it: which side of an edge it lies on is computed alike
    for both, in one direction along the edge.
    """
    corners = points[faces]
    low = np.ceil(corners[..., :2].min(1)).astype(np.int64)
    high = np.floor(corners[..., :2].max(1)).astype(np.int64)
    sides = (high - low + 1).clip(0)
    count = sides.prod(1)
    face = np.repeat(np.arange(len(faces)), count)
    rank = np.arange(len(face)) - np.repeat(count.cumsum() - count, count)
    column = low[face] + np.stack([rank // sides[face, 1].clip(1), rank % sides[face, 1].clip(1)], 1)

    x, y = column.T.astype(np.float64)
    everywhere, nowhere = np.ones(len(face), bool), np.ones(len(face), bool)  # left of all edges, and of none
    areas = []
    for k in range(3):
        a, b = corners[:, (k + 1) % 3, :2], corners[:, (k + 2) % 3, :2]
        swapped = (a[:, 0] > b[:, 0]) | ((a[:, 0] == b[:, 0]) & (a[:, 1] > b[:, 1]))
        tail, head = np.where(swapped[:, None], b, a), np.where(swapped[:, None], a, b)
        along = head - tail
        offset = along[:, 1] * tail[:, 0] - along[:, 0] * tail[:, 1]
        area = along[face, 0] * y - along[face, 1] * x + offset[face]
        side = (area >= 0) != swapped[face]
        everywhere &= side
        nowhere &= ~side
        areas.append(np.where(swapped[face], -area, area))
    hit = everywhere | nowhere
    weights = np.stack([area[hit] for area in areas], 1)
    height = (weights * corners[face[hit], :, 2]).sum(1) / weights.sum(1)
    # Seen from above, a face that looks up is passed on the way out.
    return column[hit], height, np.where(everywhere[hit], -1, 1)
