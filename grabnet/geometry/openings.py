"""Openings of a surface, such as the wrist of a hand: finding and closing them."""

from __future__ import annotations

import numpy as np


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


def close(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Meshes (N, V, 3) of shared faces (F, 3) with each opening closed by a fan around the mean of its edge.

    The given vertices stay first and the given faces too; one vertex per opening is added.

    Raises:
        ValueError: as `boundary_loops`.
    """
    centres, fans = [], []
    for k, loop in enumerate(boundary_loops(faces)):
        centres.append(vertices[:, loop].mean(1, keepdims=True))
        apex = np.full(len(loop), vertices.shape[1] + k)
        fans.append(np.stack([np.roll(loop, -1), loop, apex], 1))
    return np.concatenate([vertices, *centres], 1), np.concatenate([faces, *fans]).astype(np.asarray(faces).dtype)
