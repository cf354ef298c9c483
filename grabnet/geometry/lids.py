"""Closing the openings of a surface, such as a hand's at the wrist."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components


class Lids:
    """A fan of faces over each opening, about a new vertex in the middle of its rim.

    With them every edge joins as many faces that run along it one way as the other, however ragged the rims are.

    Args:
        n_vertices: of the surface. faces: (F, 3) of it, oriented alike.

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
        n, opening = (
            connected_components(coo_matrix((np.ones(len(a)), (index, np.searchsorted(rim, b))), (len(rim),) * 2))
            if len(rim)
            else (0, np.zeros(0, int))
        )
        self.n = n
        self.faces = np.stack([b, a, n_vertices + opening[index]], 1).astype(np.int32)
        share = 1 / np.bincount(opening, minlength=n)[opening]
        self._middle = csr_matrix((share.astype(np.float32), (opening, rim)), (n, n_vertices))

    def with_middles(self, vertices: np.ndarray) -> np.ndarray:
        """(V, 3) vertices of the surface → (V + n, 3), those of the lids included."""
        return np.concatenate([vertices, self._middle @ vertices]) if self.n else vertices
