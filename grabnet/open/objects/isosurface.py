"""Even triangle meshes of implicit solids: surface nets, then relaxation on the surface itself.

Surface nets (Gibson, "Constrained elastic surface nets", 1998) put one vertex in every grid cell the surface passes,
so the mesh is as even as the grid. A few rounds of tangential smoothing, edge flips and Newton steps back onto the zero
set then remove the grid's imprint: vertices end on the surface, not near it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Distance = Callable[[Array], Array]

_BLOCK = 8  # cells along a block of the sparse grid
_CORNERS = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(8, 3)


def isosurface(
    distance: Distance, low: ArrayLike, high: ArrayLike, edge: float, rounds: int = 8
) -> tuple[Array, NDArray[np.int64]]:
    """Mesh the zero set of a signed distance with triangles of even size.

    Args:
        distance: (N, 3) points to (N,) signed distances, negative inside; at most mildly larger than the true distance.
            Anything thinner than about 1.6 edges may be lost.
        low, high: (3,) box that holds the solid.
        edge: cell of the grid, in the unit of the points; the median edge comes out at 0.85 to 1.05 times as much.
        rounds: of relaxation.

    Returns:
        vertices (V, 3) and faces (F, 3), counter-clockwise seen from outside: closed, and manifold.

    Raises:
        ValueError: the solid reaches out of its box, or is too fine for the grid to tell what is joined.
    """
    vertices, faces = _surface_net(distance, np.asarray(low, float), np.asarray(high, float), edge)
    for _ in range(rounds):
        vertices = _projected(distance, vertices, edge)
        faces = _flipped(vertices, faces)
        vertices = vertices + 0.6 * _tangential_step(vertices, faces)
    return _projected(distance, _projected(distance, vertices, edge), edge), faces


def _surface_net(distance: Distance, low: Array, high: Array, cell: float) -> tuple[Array, NDArray[np.int64]]:
    """Surface net of the cells near the surface: vertices (V, 3) and faces (F, 3)."""
    origin = low - 1.5 * cell
    shape = np.ceil((high - origin) / cell + 2.5).astype(int)
    shape = -(-shape // _BLOCK) * _BLOCK
    values = _unambiguous(_sparse_values(distance, origin, shape, cell))

    # Crossed grid edges: along each axis, and the four cells that share the edge.
    inside = values < 0
    if any(np.take(inside, side, axis).any() for axis in range(3) for side in (0, -1)):
        raise ValueError(f"The solid reaches out of its box, from {low} to {high}.")
    points_sum = np.zeros((values.size, 3))
    points_count = np.zeros(values.size)
    quads = []
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    for axis in range(3):
        first = [slice(None)] * 3
        second = [slice(None)] * 3
        first[axis], second[axis] = slice(None, -1), slice(1, None)
        start = np.argwhere(inside[tuple(first)] != inside[tuple(second)])
        end = start + np.eye(3, dtype=int)[axis]
        a, b = values[tuple(start.T)], values[tuple(end.T)]
        crossing = start + (a / (a - b))[:, None] * np.eye(3)[axis]
        u, v = strides[(axis + 1) % 3], strides[(axis + 2) % 3]
        own = start @ strides
        around = np.stack([own, own - u, own - u - v, own - v], -1)
        for corner in range(4):
            np.add.at(points_sum, around[:, corner], crossing)
            np.add.at(points_count, around[:, corner], 1)
        quads.append(np.where((a < 0)[:, None], around, around[:, ::-1]))
    quad = np.concatenate(quads)
    used = np.flatnonzero(points_count)
    index = np.full(values.size, -1)
    index[used] = np.arange(len(used))
    vertices = origin + cell * points_sum[used] / points_count[used, None]
    return vertices, _halved(vertices, index[quad])


def _sparse_values(distance: Distance, origin: Array, shape: NDArray[np.int64], cell: float) -> Array:
    """Distances on the grid: exact in the blocks that the surface may cross, elsewhere their block's (right sign)."""
    blocks = shape // _BLOCK
    centres = np.stack(np.meshgrid(*(np.arange(n) for n in blocks), indexing="ij"), -1).reshape(-1, 3)
    middle = distance(origin + cell * ((centres + 0.5) * _BLOCK - 0.5))
    near = np.abs(middle) < 1.5 * np.sqrt(3) * _BLOCK / 2 * cell  # 1.5: distances may overestimate
    values = np.repeat(middle[:, None], _BLOCK**3, 1)
    inner = np.stack(np.meshgrid(*[np.arange(_BLOCK)] * 3, indexing="ij"), -1).reshape(-1, 3)
    grid = (centres[near, None] * _BLOCK + inner).reshape(-1, 3)
    values[near] = distance(origin + cell * grid).reshape(-1, _BLOCK**3)
    split = values.reshape(*blocks, _BLOCK, _BLOCK, _BLOCK)
    return split.transpose(0, 3, 1, 4, 2, 5).reshape(shape)


def _unambiguous(values: Array) -> Array:
    """Values whose signs never alternate around a grid face, nor single out two opposite corners of a cell.

    Such signs leave open which corners the surface joins, and make nets that touch themselves. The corner closest to
    the surface changes sides; projection puts the vertices right again.
    """
    values = np.where(values == 0, np.finfo(float).tiny, values)
    for _ in range(100):
        groups = _ambiguous_corners(values < 0)
        if not len(groups):
            return values
        size = np.abs(values.reshape(-1)[groups])
        closest = np.unique(groups[np.arange(len(groups)), size.argmin(-1)])
        values.reshape(-1)[closest] *= -2  # doubled, so that a corner does not go back and forth for ever
    raise ValueError("The solid is too fine for the grid; mesh it with a shorter edge.")


def _ambiguous_corners(inside: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(K, 4) flat grid indices: the corners of alternating faces, and (twice) of diagonals alone in their cell."""
    index = np.arange(inside.size).reshape(inside.shape)
    found = []
    for axis in range(3):
        plane, ids = np.moveaxis(inside, axis, 0), np.moveaxis(index, axis, 0)
        a, b, c, d = plane[:, :-1, :-1], plane[:, 1:, :-1], plane[:, 1:, 1:], plane[:, :-1, 1:]
        at = np.nonzero((a == c) & (b == d) & (a != b))
        found.append(np.stack([ids[at[0], at[1] + i, at[2] + j] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))], -1))
    cell = [inside[tuple(slice(o, n - 1 + o) for o, n in zip(c, inside.shape, strict=True))] for c in _CORNERS]
    count = np.sum(cell, 0, dtype=np.int8)
    for first in range(4):
        pair = (cell[first] == cell[7 - first]) & (count == np.where(cell[first], 2, 6))
        at = np.stack(np.nonzero(pair), -1)
        ends = [index[tuple((at + _CORNERS[i]).T)] for i in (first, 7 - first)]
        found.append(np.stack(ends * 2, -1))
    return np.concatenate(found)


def _halved(vertices: Array, quads: NDArray[np.int64]) -> NDArray[np.int64]:
    """Each quad as two triangles, cut along its shorter diagonal."""
    a, b, c, d = quads.T
    long = np.linalg.norm(vertices[a] - vertices[c], axis=-1) > np.linalg.norm(vertices[b] - vertices[d], axis=-1)
    return np.concatenate(
        [
            np.stack([a, b, np.where(long, d, c)], -1),
            np.stack([np.where(long, b, a), c, d], -1),
        ]
    )


def _projected(distance: Distance, vertices: Array, edge: float) -> Array:
    """Vertices moved towards the zero set by one Newton step along the gradient, no longer than half an edge."""
    value, gradient = _with_gradient(distance, vertices, 1e-2 * edge)
    step = value / np.maximum((gradient**2).sum(-1), 0.25)
    return vertices - np.clip(step, -edge / 2, edge / 2)[:, None] * gradient


def _with_gradient(distance: Distance, points: Array, offset: float) -> tuple[Array, Array]:
    """Value (N,) and gradient (N, 3) by differences over a tetrahedron: four evaluations in all."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * offset
    values = distance((points[:, None] + corners).reshape(-1, 3)).reshape(-1, 4)
    return values.mean(-1), values @ corners / (4 * offset**2)


def _vertex_normals(vertices: Array, faces: NDArray[np.int64]) -> Array:
    a, b, c = vertices[faces].transpose(1, 0, 2)
    normals = _gathered(faces, np.cross(b - a, c - a), len(vertices))
    return normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-300)


def _gathered(faces: NDArray[np.int64], values: Array, n: int) -> Array:
    """Sum over each vertex of the values (F, 3) of its faces."""
    corner = faces.reshape(-1)
    return np.stack([np.bincount(corner, np.repeat(values[:, i], 3), n) for i in range(3)], -1)


def _tangential_step(vertices: Array, faces: NDArray[np.int64]) -> Array:
    """Towards the area-weighted mean of the surrounding triangles' centres, within the tangent plane."""
    a, b, c = vertices[faces].transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=-1)
    weight = np.bincount(faces.reshape(-1), np.repeat(area, 3), len(vertices))
    mean = _gathered(faces, area[:, None] * (a + b + c) / 3, len(vertices)) / np.maximum(weight, 1e-300)[:, None]
    normal = _vertex_normals(vertices, faces)
    step = mean - vertices
    return step - (step * normal).sum(-1, keepdims=True) * normal


def _flipped(vertices: Array, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """One sweep of Delaunay flips over edges whose triangles share no other flipped edge."""
    n = len(faces)
    start, end = faces.reshape(-1), faces[:, [1, 2, 0]].reshape(-1)
    owner = np.repeat(np.arange(n), 3)
    key = np.minimum(start, end) * len(vertices) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    one, two = order[0::2], order[1::2]  # in a closed mesh half-edges come in pairs
    opposite = faces[:, [2, 0, 1]].reshape(-1)
    i, j, k, m = start[one], end[one], opposite[one], opposite[two]

    def angle(apex: NDArray[np.int64]) -> Array:
        u, v = vertices[i] - vertices[apex], vertices[j] - vertices[apex]
        return np.arctan2(np.linalg.norm(np.cross(u, v), axis=-1), (u * v).sum(-1))

    gain = angle(k) + angle(m) - np.pi
    # Flat pairs only: a flip across a bend would cut into the shape. And no edge k-m may exist already.
    normal = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-300)
    flat = (normal[owner[one]] * normal[owner[two]]).sum(-1) > 0.9
    new_key = np.minimum(k, m) * len(vertices) + np.maximum(k, m)
    edges = key[one]  # sorted
    exists = edges[np.minimum(np.searchsorted(edges, new_key), len(edges) - 1)] == new_key
    wanted = np.flatnonzero((gain > 1e-6) & flat & ~exists & (k != m))
    if not len(wanted):
        return faces
    # An edge goes ahead when it has the largest gain of all candidates at either of its triangles and its vertices.
    rank = np.empty(len(wanted), int)
    rank[np.argsort(-gain[wanted], kind="stable")] = np.arange(len(wanted))
    best = np.full(len(vertices), len(wanted))
    corners = np.stack([i, j, k, m], -1)[wanted]
    np.minimum.at(best, corners.reshape(-1), np.repeat(rank, 4))
    chosen = wanted[(best[corners] == rank[:, None]).all(-1)]
    faces = faces.copy()
    faces[owner[one[chosen]]] = np.stack([i, m, k], -1)[chosen]
    faces[owner[two[chosen]]] = np.stack([m, j, k], -1)[chosen]
    return faces
