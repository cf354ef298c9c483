"""Faces that are there more than once, and which of them to keep."""

from __future__ import annotations

import numpy as np

from grabnet.geometry.repair.topology import Edges

# Normals whose cosine is this near to 1 are those of one plane.
_PARALLEL = 1e-6


def without_doubles(faces: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which faces to keep of those with the same three corners.

    One is kept of those that run the same way. A face and its reverse are both kept, and enclose nothing, where they
    are a fin of a surface that is closed without such pairs: hung to it, or a flat sheet. Elsewhere one of them is.

    Args:
        faces: (F, 3) by place, of three places each.
        normals: (F, 3) of them, of length 1 or 0.

    Returns:
        (F,) the faces kept, and (F,) those of them that are fins.
    """
    ordered = np.sort(faces, axis=1)
    order = np.lexsort(ordered.T)
    group = np.empty(len(faces), np.int64)
    group[order] = np.append(False, (np.diff(ordered[order], axis=0) != 0).any(1)).cumsum()
    # The sorted corners run the same way as the face's where they are a cyclic exchange of them.
    second = np.take_along_axis(faces, (faces.argmin(1)[:, None] + 1) % 3, 1)[:, 0]
    way = second == ordered[:, 1]
    kept = _firsts(2 * group + way, np.ones(len(faces), bool))
    paired = kept & (np.bincount(group[kept])[group] == 2)
    if not paired.any():
        return kept, paired
    fins = np.zeros(len(faces), bool)
    fins[kept] = _fins(faces[kept], normals[kept], paired[kept])
    return kept & (~paired | fins | _firsts(group, paired)), fins


def _firsts(labels: np.ndarray, among: np.ndarray) -> np.ndarray:
    """(F,) whether each face is the first with its label among some."""
    chosen = np.flatnonzero(among)
    first = np.zeros(len(labels), bool)
    first[chosen[np.unique(labels[chosen], return_index=True)[1]]] = True
    return first


def _fins(faces: np.ndarray, normals: np.ndarray, paired: np.ndarray) -> np.ndarray:
    """(F,) which of the paired faces are fins."""
    edges = Edges.of(faces)
    single = np.repeat(~paired, 3)
    if paired.all() or (np.bincount(edges.number[single], minlength=len(edges.uses)) % 2).any():
        return np.zeros(len(faces), bool)
    part = edges.linked()
    hung = np.bincount(part, ~paired)[part] > 0
    first = np.unique(part, return_index=True)[1]
    cosine = np.abs(np.einsum("fi,fi->f", normals, normals[first[part]]))
    bent = np.bincount(part, cosine < 1 - _PARALLEL)[part] > 0
    return paired & (hung | ~bent)
