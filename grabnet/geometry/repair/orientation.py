"""Which way the faces of a surface look: those that disagree with the others are turned.

Faces that meet at an edge, two of them, are made to agree; what hangs together so is a patch. A patch that is the
whole mesh looks outward by its volume. Of several, each is judged by what it sees: its outside sees more of the far
distance; where neither side sees any, the surfaces on the way out are even in number outside and odd inside (K.
Takayama et al., A simple method for correcting facet orientations in polygon meshes based on ray casting, JCGT 3(4),
2014). Patches that agree in themselves stay as they are, unless only their back sees out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from grabnet.geometry.repair.sight import sight
from grabnet.geometry.repair.topology import Edges

# Shares of rays that see out. A patch that agrees in itself is turned where its front has less and its back more.
_BLIND, _SEEING = 0.1, 0.25
# Differences between front and back that decide about a patch of faces that disagreed.
_SEEN, _ODD = 0.05, 0.2
# Faces that are asked, the largest of each patch, and in all.
_OF_PATCH, _ASKED = 32, 20_000


class UndecidedError(ValueError):
    """Neither side of some faces can be called the outside."""


class _Patches(NamedTuple):
    """Faces that were made to agree.

    number: (F,) of the patch of each face. turned: (F,) whether it has to turn for that. Of each patch: disagreed,
    whether faces of it did; closed, whether each of its edges joins two faces; twisted, whether it has one side only,
    a patch then being a single face of it.
    """

    number: np.ndarray
    turned: np.ndarray
    disagreed: np.ndarray
    closed: np.ndarray
    twisted: np.ndarray


def wrong_way(vertices: np.ndarray, faces: np.ndarray, by_place: np.ndarray) -> np.ndarray:
    """(F,) which faces have to turn for all to look outward.

    Args:
        vertices: (V, 3).
        faces: (F, 3) of them.
        by_place: (F, 3) the same by place (`topology.places`).

    Raises:
        UndecidedError: a surface of one side only that rays do not decide about, or too many patches of which some
            have to turn.
    """
    corners = vertices[faces].astype(np.float64)
    corners -= vertices[np.unique(faces)].mean(0, dtype=np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    patches = _patches(by_place, area)
    turned = patches.turned.copy()
    if _volumes(corners, turned, np.zeros(len(faces), np.int64))[0] < 0:
        turned = ~turned
    n = len(patches.closed)
    if n == 1 and not patches.twisted.any():
        return turned
    mean = np.stack([np.bincount(patches.number, corners[..., i].mean(1)) for i in range(3)], 1)
    mean /= np.bincount(patches.number)[:, None]
    volume = _volumes(corners - mean[patches.number][:, None], turned, patches.number)
    asked = patches.disagreed | ~patches.closed | (volume < 0)
    if not asked.any():
        return turned
    chosen = _largest(patches.number, np.where(asked[patches.number], area, 0))
    if not len(chosen):
        return turned
    outward = normals[chosen] / area[chosen, None] * np.where(turned[chosen], -1, 1)[:, None]
    free, odd = (
        np.stack([np.bincount(patches.number[chosen], area[chosen] * side, n) for side in seen.T], 1)
        / np.bincount(patches.number[chosen], area[chosen], n).clip(1e-300)[:, None]
        for seen in sight(vertices, faces, chosen, outward)
    )
    back = (free[:, 0] < _BLIND) & (free[:, 1] > _SEEING)
    seen, counted = free[:, 0] - free[:, 1], odd[:, 1] - odd[:, 0]
    undecided = (np.abs(seen) <= _SEEN) & (np.abs(counted) <= _ODD)
    if (undecided & patches.twisted).any():
        raise UndecidedError
    by_rays = np.where(np.abs(seen) > _SEEN, seen, counted) < 0
    back = np.where(patches.disagreed, np.where(undecided, volume < 0, by_rays), back) & asked
    if back.any() and len(np.unique(patches.number[chosen])) < asked.sum():
        raise UndecidedError
    return turned ^ back[patches.number]


def _patches(faces: np.ndarray, area: np.ndarray) -> _Patches:
    edges, n = Edges.of(faces), len(faces)
    pairs, agree = edges.pairs()
    one, other = pairs.T
    # Every face twice, as it is and turned; those that agree are linked.
    links = np.concatenate([one, one + n]), np.concatenate([other + n * ~agree, other + n * agree])
    label = connected_components(coo_matrix((np.ones(2 * len(one), bool), links), (2 * n, 2 * n)), directed=False)[1]
    twisted = label[:n] == label[n:]
    number = np.where(twisted, 2 * n + np.arange(n), np.minimum(label[:n], label[n:]))
    number = np.unique(number, return_inverse=True)[1]
    turned = label[:n] > label[n:]
    # The greater part of each patch stays.
    turned ^= (np.bincount(number, np.where(turned, area, -area)) > 0)[number]
    n_patches = number.max(initial=-1) + 1
    counts = np.bincount(number, turned, n_patches)
    single = np.zeros(n_patches, bool)
    single[number[twisted]] = True
    disagreed = ((counts > 0) & (counts < np.bincount(number, minlength=n_patches))) | single
    open_sides = edges.uses[edges.number] != 2
    closed = np.bincount(number[edges.faces[open_sides]], minlength=n_patches) == 0
    return _Patches(number, turned, disagreed, closed & ~single, single)


def _volumes(corners: np.ndarray, turned: np.ndarray, number: np.ndarray) -> np.ndarray:
    """Volume of each patch, as closed towards the origin."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return np.bincount(number, np.where(turned, -1, 1) * np.einsum("fi,fi->f", a, np.cross(b, c)) / 6)


def _largest(number: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Numbers of the largest faces of each patch, of those with an area; the very largest of all patches first."""
    order = np.lexsort((-area, number))
    start = np.append(True, np.diff(number[order]) != 0)
    rank = np.arange(len(order)) - np.flatnonzero(start)[start.cumsum() - 1]
    fit = (rank < _OF_PATCH) & (area[order] > 0)
    order, rank = order[fit], rank[fit]
    return order[np.lexsort((-area[order], rank))][:_ASKED]
