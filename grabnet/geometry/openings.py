"""Openings of a surface, such as the wrist of a hand: finding and closing them."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components


def boundary_loops(faces: np.ndarray) -> list[np.ndarray]:
    """Vertices (L,) around each opening of faces (F, 3), along the direction of the faces' edges.

    Each loop starts at its lowest vertex, and loops are in order of these.

    Raises:
        ValueError: the boundary is not made of simple loops.
    """
    start, end = np.asarray(faces, np.int64), np.roll(np.asarray(faces, np.int64), -1, axis=1)
    n = int(start.max(initial=-1)) + 1
    edges, reversed_edges = (start * n + end).ravel(), (end * n + start).ravel()
    follows = {int(e // n): int(e % n) for e in np.setdiff1d(edges, reversed_edges)}
    if len(follows) < len(np.setdiff1d(edges, reversed_edges)) or set(follows) != set(follows.values()):
        raise ValueError("the boundary edges of this mesh don't form simple loops")
    loops = []
    for first in sorted(follows):
        loop = []
        while first in follows:
            loop.append(first)
            first = follows.pop(first)
        if loop:
            loops.append(np.array(loop))
    return loops


class Lids:
    """A fan of faces over each opening of a surface, about a new vertex in the middle of its rim.

    With them every edge joins as many faces that run along it one way as the other, however ragged the rims are.

    Args:
        n_vertices: number of vertices of the surface.
        faces: (F, 3), all oriented alike.

    Attributes:
        faces: (L, 3), to be appended to the surface's; none where it is closed.
        n: number of openings, whose middles follow the surface's vertices.
    """

    def __init__(self, n_vertices: int, faces: np.ndarray):
        start = np.asarray(faces, np.int64).ravel()
        end = np.roll(np.asarray(faces, np.int64), -1, 1).ravel()
        edges, count = np.unique(np.minimum(start, end) * n_vertices + np.maximum(start, end), return_inverse=True)
        surplus = np.bincount(count, np.where(start < end, 1, -1), len(edges)).astype(int)
        low, high = np.divmod(edges, n_vertices)
        # The rim's edges as the surface's faces run along them, as often as no other face runs back.
        a = np.repeat(np.where(surplus > 0, low, high), np.abs(surplus))
        b = np.repeat(np.where(surplus > 0, high, low), np.abs(surplus))
        rim, index = np.unique(a, return_inverse=True)
        graph = coo_matrix((np.ones(len(a)), (index, np.searchsorted(rim, b))), (len(rim),) * 2)
        self.n, opening = connected_components(graph) if len(rim) else (0, np.zeros(0, int))
        self.faces = np.stack([b, a, n_vertices + opening[index]], 1).astype(np.asarray(faces).dtype)
        self._rim = rim[np.argsort(opening, kind="stable")]  # one opening after the other
        self._size = np.bincount(opening, minlength=self.n)

    def with_middles(self, vertices: np.ndarray) -> np.ndarray:
        """(..., V, 3) vertices of the surface → (..., V + n, 3), those of the lids included."""
        if not self.n:
            return vertices
        total = np.add.reduceat(vertices[..., self._rim, :], np.cumsum(self._size) - self._size, axis=-2)
        return np.concatenate([vertices, total / self._size[:, None].astype(vertices.dtype)], -2)


def close(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Close each opening of a surface (..., V, 3) of faces (F, 3) by its lid.

    Returns:
        vertices (..., V + openings, 3) and faces (F + L, 3), the given ones first.
    """
    lids = Lids(np.shape(vertices)[-2], faces)
    return lids.with_middles(vertices), np.concatenate([faces, lids.faces])
