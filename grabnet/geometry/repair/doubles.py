"""Surface that is there more than once, and which of its layers to keep.

A layer is a patch of faces that runs up to its rim: edges at which it meets more than one other face, or at which the
surface ends or folds back onto itself. Where both layers are cut into faces alike each face is a patch; where they are
cut otherwise, what lies between the edges that they share is one.
"""

from __future__ import annotations

import numpy as np
import torch
import warp as wp
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from grabnet.geometry.kernels import queries as kernels
from grabnet.geometry.kernels.launch import launch
from grabnet.geometry.repair.topology import Edges

# Directions whose cosine is this near to 1 are parallel.
_PARALLEL = 1e-6
# How far layers of one rim may lie apart, of the length of their faces: flat faces across a curved surface.
_APART = 0.2


def without_doubles(faces: np.ndarray, corners: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which faces to keep where patches of them are there more than once.

    One patch is kept of those that run the same way. A patch and its reverse are both kept, and enclose nothing, where
    they are a fin: hung to a part that is closed without such pairs, between parts that touch, or a flat sheet beside
    closed parts. Elsewhere one of them is.

    Args:
        faces: (F, 3) by place, of three places each.
        corners: (F, 3, 3) float64 of them.
        normals: (F, 3) of them, of length 1 or 0.

    Returns:
        (F,) the faces kept, and (F,) those of them that are fins.
    """
    edges = Edges.of(faces)
    patch, rim = _patches(edges, corners)
    first = _first_layers(edges, corners, patch, rim)
    kept = _firsts(2 * first + _ways(edges, patch, rim))
    paired = kept & (np.bincount(first[kept], minlength=len(first))[first] == 2)
    fins = np.zeros(len(faces), bool)
    if paired.any():
        there = kept[patch]
        fins[there] = _fins(faces[there], normals[there], paired[patch[there]])
    single = kept & ~(paired & (first != np.arange(len(first))))
    return single[patch] | fins, fins


def _patches(edges: Edges, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(F,) the patch of each face, in order of their first faces, and (3 F,) which sides of faces are at a rim."""
    sides = edges.sides()
    one, other = (_across(corners, sides[:, k]) for k in range(2))
    lengths = np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1)
    folded = np.einsum("pi,pi->p", one, other) > (1 - _PARALLEL) * lengths
    joined = edges.faces[sides[~folded]].T
    n = len(corners)
    patch = connected_components(coo_matrix((np.ones(joined.shape[1], bool), (*joined,)), (n, n)), directed=False)[1]
    ends = edges.uses != 2
    ends[edges.number[sides[folded, 0]]] = True
    return patch.astype(np.int64), ends[edges.number]


def _across(corners: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """(P, 3) from sides of faces to the corners opposite, at right angles to the sides."""
    face, k = np.divmod(sides, 3)
    along = corners[face, (k + 1) % 3] - corners[face, k]
    up = corners[face, (k + 2) % 3] - corners[face, k]
    share = np.einsum("pi,pi->p", up, along) / np.einsum("pi,pi->p", along, along).clip(1e-300)
    return up - share[:, None] * along


def _first_layers(edges: Edges, corners: np.ndarray, patch: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """(N,) for each patch the first one with the same rim and bounding box that it lies on, or itself."""
    n = patch.max() + 1
    mark = np.random.default_rng(0).integers(1 << 62, size=len(edges.uses))  # of edges; their sum is that of a rim
    rims = np.zeros(n, np.int64)
    np.add.at(rims, patch[edges.faces[rim]], mark[edges.number[rim]])
    low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    np.minimum.at(low, patch, corners.min(1))
    np.maximum.at(high, patch, corners.max(1))
    keys = np.stack([rims, *low.T, *high.T])
    order = np.lexsort(keys)
    starts = np.append(True, (np.diff(keys[:, order]) != 0).any(0))
    first = np.empty(n, np.int64)
    first[order] = order[starts][starts.cumsum() - 1]  # the sort is stable
    later = first != np.arange(n)
    if later.any():
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        length = np.sqrt(np.bincount(patch, area) / np.bincount(patch))
        asked = later[patch]
        reach = _APART * np.maximum(length, length[first])[patch[asked]]
        beside = patch[asked][~_lies_on(corners[asked], corners[np.isin(patch, first[later])], reach)]
        first[beside] = beside
    return first


def _lies_on(corners: np.ndarray, surface: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """(F,) whether corners and middles of faces (F, 3, 3) are within reach (F,) of those of a surface."""
    points = np.concatenate([corners, corners.mean(1, keepdims=True)], 1)
    middle, size = surface.mean((0, 1)), np.ptp(surface, axis=(0, 1)).max() or 1.0
    on = wp.array(((surface - middle) / size).reshape(-1, 3).astype(np.float32), dtype=wp.vec3, device="cpu")
    mesh = wp.Mesh(on, wp.array(np.arange(on.size, dtype=np.int32), dtype=wp.int32, device="cpu"))
    asked = torch.from_numpy(((points - middle) / size).reshape(-1, 3).astype(np.float32))
    distance, position = torch.full((len(asked),), torch.inf), torch.zeros_like(asked)
    face = torch.full((len(asked),), -1, dtype=torch.int32)
    launch(kernels.closest_point, [asked, distance, position, face], [mesh.id, 1.0])
    return (distance.numpy().reshape(-1, 4) * size <= reach[:, None]).all(1)


def _ways(edges: Edges, patch: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """(N,) which way each patch runs along the lowest edge of its rim; False without a rim."""
    sides = np.flatnonzero(rim)
    of = patch[edges.faces[sides]]
    order = np.lexsort((edges.number[sides], of))
    patches, start = np.unique(of[order], return_index=True)
    ways = np.zeros(patch.max() + 1, bool)
    ways[patches] = edges.forward[sides[order[start]]]
    return ways


def _firsts(labels: np.ndarray) -> np.ndarray:
    """(N,) whether each is the first with its label."""
    first = np.zeros(len(labels), bool)
    first[np.unique(labels, return_index=True)[1]] = True
    return first


def _fins(faces: np.ndarray, normals: np.ndarray, paired: np.ndarray) -> np.ndarray:
    """(F,) which of the paired faces are fins."""
    if paired.all():
        return np.zeros(len(faces), bool)
    edges = Edges.of(faces)
    part = edges.linked()
    odd = np.bincount(edges.number, np.repeat(~paired, 3))[edges.number] % 2 > 0
    open_ = np.bincount(part, odd.reshape(-1, 3).any(1))[part] > 0
    hung = np.bincount(part, ~paired)[part] > 0
    first = np.unique(part, return_index=True)[1]
    cosine = np.abs(np.einsum("fi,fi->f", normals, normals[first[part]]))
    bent = np.bincount(part, cosine < 1 - _PARALLEL)[part] > 0
    return paired & np.where(hung, ~open_, ~bent & ~odd.any())
