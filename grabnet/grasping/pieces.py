"""Into how many pieces an object cuts a hand: what a mesh boolean, hand minus object, would fall apart into."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from grabnet.geometry.intersections import Crossings, MovingMesh, find_crossings

SLIVER = 0.0002  # metres: what no vertex of rises so far from the object is a graze, no piece
_ON_SURFACE = 1e-6  # metres, within which rounding decides on which side a vertex is


def count_pieces(hand: MovingMesh, solid: MovingMesh, distances: np.ndarray, lines: np.ndarray) -> int:
    """How many pieces of a hand are left outside an object, slivers apart; 0 where none is.

    Pieces hold together along the hand's skin outside the object, along the object's surface inside the hand, and along
    lines through the hand that miss the object. Where the two surfaces cut each other, in rings, one goes on in the
    other.

    Args:
        hand, solid: the surfaces, both closed and facing outwards.
        distances: (V of the hand,) metres from its vertices to the object, negative inside.
        lines: (L, 2) pairs joined by such a line: vertices of the hand, and numbers from V on
            for points inside it.
    """
    inside, outside = distances < 0, distances > SLIVER
    first_ring = max(len(hand.vertices), int(lines.max(initial=0)) + 1)
    if len(np.unique(_joined([lines], first_ring)[: len(inside)][outside])) < 2:
        return int(outside.any())  # as in grasps that hold as hands do
    crossings = find_crossings(hand, solid)
    if not crossings.n_rings:
        return int(outside.any())
    n = first_ring + crossings.n_rings
    cuts = _Cuts.of(hand, crossings, False)
    inside = np.where(np.abs(distances) < _ON_SURFACE, cuts.enclosed(np.arange(len(inside))), inside)
    skin = _along(cuts, ~inside, 0, first_ring, is_inside=False)
    links = [lines, skin, _within_faces(hand, crossings, inside, first_ring)]
    if len(np.unique(_joined(links, n)[: len(outside)][outside])) > 1:
        # Vertices beyond the hand are as good as one.
        low, high = hand.bounds
        near = ((solid.vertices >= low) & (solid.vertices <= high)).all(1)
        number = near.cumsum() * near
        cuts = _Cuts.of(solid, crossings, True)
        links.append(_along(cuts, cuts.enclosed(number), n, first_ring, is_inside=True))
    return len(np.unique(_joined(links, n + len(solid.vertices))[: len(outside)][outside]))


@dataclass(frozen=True)
class _Cuts:
    """C places where edges of one surface pass the other, edge by edge and in the order along it.

    edge, ring: (C,). rise: (C,) 1 into the other solid, -1 out of it. first, last: (C,) bool, of its edge. low, high:
    (C,) where the edge starts and ends. whole: (E, 2) vertices of the edges that are not cut.
    """

    edge: np.ndarray
    ring: np.ndarray
    rise: np.ndarray
    first: np.ndarray
    last: np.ndarray
    low: np.ndarray
    high: np.ndarray
    whole: np.ndarray

    @classmethod
    def of(cls, mesh: MovingMesh, crossings: Crossings, of_object: bool) -> _Cuts:
        mine = (crossings.of_object == of_object).nonzero()[0]
        mine = mine[np.lexsort((crossings.along[mine], crossings.edge[mine]))]
        edge = crossings.edge[mine]
        other = edge[1:] != edge[:-1]
        first, last = (np.append(True, other), np.append(other, True)) if len(edge) else (edge > 0, edge > 0)
        rise = np.where(crossings.entering[mine], 1, -1)
        whole = np.ones(len(mesh.edges), bool)
        whole[edge] = False
        return cls(edge, crossings.ring[mine], rise, first, last, *mesh.edges[edge].T, mesh.edges[whole])

    def enclosed(self, number: np.ndarray) -> np.ndarray:
        """(V,) bool: vertices inside the other solid, by the cuts about the patch of the surface that each lies in.

        Args:
            number: (V,) of each vertex; what shares one counts as one.
        """
        ends = number[self.whole]
        patch = _joined([ends[ends[:, 0] != ends[:, 1]]], int(number.max()) + 1)[number]
        votes = np.zeros(len(number), int)
        np.add.at(votes, patch[self.low[self.first]], -self.rise[self.first])
        np.add.at(votes, patch[self.high[self.last]], self.rise[self.last])
        return votes[patch] > 0


def _along(cuts: _Cuts, kept: np.ndarray, first_vertex: int, first_ring: int, is_inside: bool) -> np.ndarray:
    """(L, 2) what holds together along a surface's edges on one side of the other surface: vertices and rings.

    Args:
        kept: (V,) bool, vertices on that side.
        first_vertex, first_ring: how they are numbered.
        is_inside: which side.
    """
    of_edge = cuts.first.cumsum() - 1
    total = cuts.rise.cumsum()
    after = total - (total - cuts.rise)[cuts.first][of_edge]
    # How often the other solid contains the start of the edge: at least so often that no part is in it less than never.
    inside = (kept == is_inside).astype(int)
    start = inside[cuts.low[cuts.first]]
    np.maximum.at(start, of_edge, -after)
    start = np.maximum(start, inside[cuts.high[cuts.last]] - after[cuts.last])
    goes_on = (after + start[of_edge] > 0) == is_inside
    starts = (start > 0) == is_inside
    ring = first_ring + cuts.ring
    next_ring = goes_on[:-1] & ~cuts.last[:-1]
    return np.concatenate(
        [
            first_vertex + cuts.whole[kept[cuts.whole].all(1)],
            np.stack([first_vertex + cuts.low, ring], 1)[cuts.first][starts],
            np.stack([ring, np.roll(ring, -1)], 1)[:-1][next_ring],
            np.stack([ring, first_vertex + cuts.high], 1)[cuts.last & goes_on],
        ]
    )


def _within_faces(hand: MovingMesh, crossings: Crossings, inside: np.ndarray, first_ring: int) -> np.ndarray:
    """(L, 2) corners outside the object of faces that rings lie within, and these rings: the rest of a face joins
    them."""
    passes_edges = np.zeros(crossings.n_rings, bool)
    passes_edges[crossings.ring[~crossings.of_object]] = True
    within = ~passes_edges[crossings.body_face_ring]
    corners = hand.faces[crossings.body_faces[within]].ravel()
    rings = np.repeat(first_ring + crossings.body_face_ring[within], 3)
    return np.stack([corners, rings], 1)[~inside[corners]]


def _joined(links: list[np.ndarray], n: int) -> np.ndarray:
    """(n,) number of the connected part that each node is in."""
    start, end = np.concatenate(links).T
    return connected_components(coo_matrix((np.ones(len(start), bool), (start, end)), (n, n)), directed=False)[1]
