"""What a mesh file holds, and how its polygons become triangles."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

MAX_FACES = 2_000_000
# A corner that turns the other way by less than this share of its sides' product is taken as straight.
_STRAIGHT = 1e-9
# Squares of the corners of hollow polygons of a size, at most: cutting them takes seconds.
_MOST_CUTTING = 4_000_000


class FormatError(ValueError):
    """What is wrong with a file's content, in words that go into brackets behind its name."""


class Geometry(NamedTuple):
    """Vertices (V, 3) float64 and faces (F, 3) int64, in the file's frame and units."""

    vertices: np.ndarray
    faces: np.ndarray


def triangulated(vertices: np.ndarray, counts: np.ndarray, corners: np.ndarray) -> Geometry:
    """Triangles of polygons; those of a polygon and of the same one reversed are the same, reversed.

    Args:
        vertices: (V, 3).
        counts: (P,) corners of each polygon; fewer than three make no face.
        corners: (counts.sum(),) vertex numbers, one polygon after the other.

    Raises:
        FormatError: a corner at no vertex.
    """
    vertices, corners = np.asarray(vertices, np.float64).reshape(-1, 3), np.asarray(corners, np.int64)
    if len(corners) and not (corners.min() >= 0 and corners.max() < len(vertices)):
        worst = corners.min() if corners.min() < 0 else corners.max()
        raise FormatError(f"a face names vertex {worst}, counted from 0, of {len(vertices)}: export it again")
    counts = np.asarray(counts, np.int64)
    start = np.cumsum(counts) - counts
    sizes = [int(k) for k in np.unique(counts) if k >= 3]
    rank = _by_place(vertices) if sizes and sizes[-1] > 3 else None
    faces, order = [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)]
    for size in sizes:
        which = np.flatnonzero(counts == size)
        polygons = corners[start[which, None] + np.arange(size)]
        faces.append(polygons if size == 3 else _cut(vertices, polygons, rank))
        order.append(np.repeat(which, size - 2))
    return Geometry(vertices, np.concatenate(faces)[np.argsort(np.concatenate(order), kind="stable")])


def _by_place(vertices: np.ndarray) -> np.ndarray:
    """(V,) a number for each place, the same for vertices at the same one."""
    order = np.lexsort(vertices.T)
    new = np.append(False, (np.diff(vertices[order], axis=0) != 0).any(1))
    rank = np.empty(len(vertices), np.int64)
    rank[order] = new.cumsum()
    return rank


def _cut(vertices: np.ndarray, polygons: np.ndarray, rank: np.ndarray) -> np.ndarray:
    """Polygons (P, k) of at least four corners as triangles (P (k - 2), 3)."""
    count, size = polygons.shape
    # Every polygon starts at its lowest corner and goes on to the lower of its neighbours.
    polygons = np.take_along_axis(polygons, (rank[polygons].argmin(1)[:, None] + np.arange(size)) % size, 1)
    turned = rank[polygons[:, 1]] > rank[polygons[:, -1]]
    polygons[turned, 1:] = polygons[turned, :0:-1]
    triangles = polygons[:, [corner for k in range(1, size - 1) for corner in (0, k, k + 1)]].reshape(count, -1, 3)
    reflex = _reflex(vertices[polygons])
    if size == 4:
        other = reflex[:, 1] | reflex[:, 3]  # cut from there instead
        triangles[other] = polygons[other][:, [[1, 2, 3], [1, 3, 0]]]
    elif (hollow := np.flatnonzero(reflex.any(1))).size:
        if len(hollow) * size**2 > _MOST_CUTTING:
            raise FormatError(f"it has {len(hollow):,} hollow faces of {size:,} corners: export it as triangles")
        for p in hollow:
            triangles[p] = polygons[p][_ears(vertices[polygons[p]])]
    triangles[turned] = triangles[turned, :, ::-1]
    return triangles.reshape(-1, 3)


def _reflex(points: np.ndarray) -> np.ndarray:
    """(P, k) at which corners polygons (P, k, 3) turn against the way that they turn as a whole."""
    with np.errstate(invalid="ignore", over="ignore"):
        points = points - points.mean(1, keepdims=True)
        side = np.roll(points, -1, 1) - points
        normal = np.cross(points, np.roll(points, -1, 1)).sum(1)
        turn = np.cross(np.roll(side, 1, 1), side)
        length = np.linalg.norm(side, axis=-1)
        bound = _STRAIGHT * length * np.roll(length, 1, 1) * np.linalg.norm(normal, axis=-1)[:, None]
        return np.einsum("pkx,px->pk", turn, normal) < -bound


def _ears(points: np.ndarray) -> np.ndarray:
    """(k - 2, 3) numbers of the corners of a polygon (k, 3) that is not convex, by cutting off ears."""
    points = points - points.mean(0)
    normal = np.cross(points, np.roll(points, -1, 0)).sum(0)
    flat = points[:, np.abs(normal).argsort()[:2]]  # seen along the axis that the normal is nearest to
    x, y = flat.T
    if (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() < 0:
        flat = flat * [-1, 1]
    left, triangles = list(range(len(points))), []
    while len(left) > 3:
        ear = next((i for i in range(len(left)) if _is_ear(flat, left, i)), 0)  # one that crosses itself has none
        triangles.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        left.pop(ear)
    return np.array([*triangles, left])


def _is_ear(flat: np.ndarray, left: Sequence[int], i: int) -> bool:
    """Whether corner i of those left turns left and no other lies within its triangle."""
    a, b, c = (flat[left[j % len(left)]] for j in (i - 1, i, i + 1))

    def beside(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
        return (q[0] - p[0]) * (r[..., 1] - p[1]) - (q[1] - p[1]) * (r[..., 0] - p[0])

    if beside(a, b, c) <= 0:
        return False
    others = flat[left]
    others = others[np.logical_and.reduce([(others != corner).any(1) for corner in (a, b, c)])]
    return not ((beside(a, b, others) >= 0) & (beside(b, c, others) >= 0) & (beside(c, a, others) >= 0)).any()


def gathered(polygons: Sequence[Sequence[int]]) -> tuple[np.ndarray, np.ndarray]:
    """Counts (P,) and corners of polygons, as `triangulated` takes them."""
    counts = np.fromiter(map(len, polygons), np.int64, len(polygons))
    return counts, whole_numbers(list(chain.from_iterable(polygons)))


def whole_numbers(values: Sequence[int]) -> np.ndarray:
    """(N,) int64.

    Raises:
        FormatError: a number beyond 64 bits.
    """
    try:
        return np.array(values, np.int64)
    except OverflowError:
        raise FormatError("a face names a vertex beyond all that there can be: export it again") from None
