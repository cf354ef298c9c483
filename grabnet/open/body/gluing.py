"""Giving a body hands of another shape: the hand's vertices are set, and the forearm follows smoothly."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import factorized


class Gluing:
    """Sets the hand of bodies in rest pose.

    The displacement of the forearm is biharmonic: it continues the hand's in value and slope and ends at `reach`.

    Args:
        vertices (V, 3), faces (F, 3): a body. hand: (H,) its vertices that are set.
        reach: metres from the hand along the arm (x) within which the forearm follows.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, hand: np.ndarray, reach: float = 0.08):
        n, x = len(vertices), np.abs(vertices[:, 0])
        side = np.sign(vertices[hand, 0].mean())
        near = (vertices[:, 0] * side > 0) & (x > x[hand].min() - reach)
        near[hand] = False
        self.hand, self.free = hand, near.nonzero()[0]
        a, b = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1).T
        # An edge that two faces share is listed twice: the same factor for nearly all.
        graph = sparse.coo_matrix((1 / np.linalg.norm(vertices[a] - vertices[b], axis=1), (a, b)), (n, n)).tocsr()
        graph = graph + graph.T
        laplacian = sparse.diags(1 / np.asarray(graph.sum(1)).ravel()) @ graph - sparse.identity(n)
        bending = (laplacian.T @ laplacian).tocsr()
        self._from_hand = -bending[self.free][:, hand]
        self._solve = factorized(bending[self.free][:, self.free].tocsc())

    def __call__(self, vertices: np.ndarray, hand: np.ndarray) -> np.ndarray:
        """Bodies (..., V, 3) with their hands' vertices at `hand` (..., H, 3)."""
        glued = vertices.astype(np.float64)
        moved = np.moveaxis(hand - glued[..., self.hand, :], -2, 0)
        follow = self._solve(self._from_hand @ moved.reshape(len(moved), -1))
        glued[..., self.free, :] += np.moveaxis(follow.reshape(-1, *moved.shape[1:]), 0, -2)
        glued[..., self.hand, :] = hand
        return glued
