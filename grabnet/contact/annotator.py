"""Contact between body and object from their surfaces (paper 3.3, S.7; ref. 4).

Tracked bodies reach into objects and stop short of them by millimetres. Where surfaces cut through each other, in
rings, the object's vertices within the ring are touched (over-shooting); elsewhere what is near enough is
(under-shooting). Openings of the body, such as the wrist of a hand used alone, are closed by lids: they bound what is
inside it, but nothing touches them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from grabnet.contact.bones import Bones
from grabnet.contact.contacts import CONTACT_DISTANCE
from grabnet.geometry.intersections import Crossings, MovingMesh, find_crossings
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.openings import Lids


@dataclass(frozen=True)
class Contact:
    """What touches what, in one frame.

    Attributes:
        object: (V of the object,) uint8, the part of the body that touches each vertex, 0 for none; nonzero is the
            binary label.
        body: (V of the body,) uint8, each touching vertex's own part, 0 for the others.
        face: (V of the object,) int32, the face of the body nearest to each touched vertex; -1 elsewhere.
        barycentric: (V of the object, 3) float32, weights of that face's corners that make up the nearest point; NaN
            elsewhere. With `face` the dense correspondence.
    """

    object: np.ndarray
    body: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray


class ContactAnnotator:
    """Finds contact of a moving body with one object.

    Args:
        object_mesh: the object.
        rest: (V, 3) a pose of the body, metres.
        faces: (F, 3) of the body, facing outwards.
        parts: (V,) label of each body vertex, 1 … 55 in GRAB; see `vertex_parts`.
        distance: ε, metres, within which surfaces that don't cut each other touch.
        measured_to: "surface", ε from vertices of either to the surface of the other; "vertices", to the vertices of
            the other, as the paper has it.
        bones: of the body; the nearest one labels what touches the object (the paper's way). Without them the part of
            the nearest skin does.
    """

    def __init__(
        self,
        object_mesh: Mesh,
        rest: np.ndarray,
        faces: np.ndarray,
        parts: np.ndarray,
        distance: float = CONTACT_DISTANCE,
        measured_to: str = "surface",
        bones: Bones | None = None,
    ):
        self._lids = Lids(len(rest), faces)
        self.body = MovingMesh(self._lids.with_middles(rest), np.concatenate([faces, self._lids.faces]))
        self.object_mesh = MovingMesh(object_mesh.vertices, object_mesh.faces)
        self.parts = np.asarray(parts, np.uint8)
        self.distance = distance
        self.bones = bones
        self._near_free = self._near_free_vertices if measured_to == "vertices" else self._near_free_surface
        # Of each face: two corners' part, if two agree; lids are no part.
        self.face_parts = np.zeros(len(self.body.faces), np.uint8)
        self.face_parts[: len(faces)] = np.sort(self.parts[faces], 1)[:, 1]
        self._skin = np.arange(len(self.body.faces)) < len(faces)
        self._around = _Neighbours(len(object_mesh.vertices), self.object_mesh.edges)

    def __call__(self, vertices: np.ndarray) -> Contact:
        """Contact of the body at `vertices` (V, 3), metres, in the object's frame."""
        self.body.move(self._lids.with_middles(vertices))
        crossings = find_crossings(self.body, self.object_mesh)
        touched = self._enclosed(crossings, self._counting_rings(crossings))
        cutting = np.unique(self.face_parts[crossings.body_faces[self._skin[crossings.body_faces]]])

        n = len(self.object_mesh.vertices)
        face, position = np.full(n, -1, np.int32), np.zeros((n, 3), np.float32)
        body = np.zeros(len(self.parts), bool)
        if touched.any():
            face[touched], position[touched] = self._closest_skin(self.object_mesh.vertices[touched])
            near = self._near_object().nonzero()[0]
            reach, _ = cKDTree(self.object_mesh.vertices[touched]).query(
                self.body.vertices[near], distance_upper_bound=self.distance
            )
            body[near[reach <= self.distance]] = True

        hovering = (self._near_body() & ~touched).nonzero()[0]
        near = (self._near_object() & ~np.isin(self.parts, cutting)).nonzero()[0]
        face[hovering], position[hovering], reached = self._near_free(hovering, near, cutting)
        body[near] |= reached

        found = face >= 0
        weights = np.full((n, 3), np.nan, np.float32)
        weights[found] = _barycentric(self.body.vertices[self.body.faces[face[found]]], position[found])
        labels = np.zeros(n, np.uint8)
        if self.bones is None:
            labels[found] = self.parts[self.body.faces[face[found], weights[found].argmax(1)]]
        elif found.any():
            labels[found] = self.bones.nearest_parts(vertices, self.object_mesh.vertices[found])
        return Contact(labels, np.where(body, self.parts, 0).astype(np.uint8), face, weights)

    def _near_free_surface(
        self, hovering: np.ndarray, near: np.ndarray, cutting: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the parts that cut nothing touch, within ε of surfaces.

        Args:
            hovering: (N,) object vertices that may be touched.
            near: (M,) body vertices, of parts that cut nothing, that may touch.
            cutting: the other parts.

        Returns:
            face (N,), -1 for none, and position (N, 3) on it, of the body; touching (M,).
        """
        free = self._skin & ~np.isin(self.face_parts, cutting)
        face, position = self.body.closest(self.object_mesh.vertices[hovering], self.distance, free)
        return face, position, self.object_mesh.closest(self.body.vertices[near], self.distance)[0] >= 0

    def _near_free_vertices(
        self, hovering: np.ndarray, near: np.ndarray, cutting: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `_near_free_surface`, within ε of vertices."""
        face, position = np.full(len(hovering), -1, np.int32), np.zeros((len(hovering), 3), np.float32)
        if not len(hovering) or not len(near):
            return face, position, np.zeros(len(near), bool)
        points, vertices = self.object_mesh.vertices[hovering], self.body.vertices[near]
        is_near = cKDTree(vertices).query(points)[0] <= self.distance
        # The nearest point of the skin about a vertex is no farther than the vertex, but for rounding.
        is_free = np.zeros(len(self.body.vertices), bool)
        is_free[near] = True
        around = self._skin & is_free[self.body.faces].any(1)
        face[is_near], position[is_near] = self.body.closest(points[is_near], 1.001 * self.distance, around)
        return face, position, self._tree.query(vertices)[0] <= self.distance

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.object_mesh.vertices)

    def _closest_skin(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Face (N,) and position (N, 3) of the body nearest to each point, lids left out."""
        face, position = self.body.closest(points)
        lid = ~self._skin[face]
        face[lid], position[lid] = self.body.closest(points[lid], faces=self._skin)
        return face, position

    def _near_object(self) -> np.ndarray:
        """(V,) body vertices within ε of the object's bounding box."""
        return self._within(self.body.vertices[: len(self.parts)], *self.object_mesh.bounds)

    def _near_body(self) -> np.ndarray:
        """Object vertices within ε of the bounding box of those body faces that come near the object."""
        low, high = self.object_mesh.bounds
        near = self.body.faces[self.body.faces_near(low - self.distance, high + self.distance)]
        if not len(near):
            return np.zeros(len(self.object_mesh.vertices), bool)
        corners = self.body.vertices[near.ravel()]
        return self._within(self.object_mesh.vertices, corners.min(0), corners.max(0))

    def _within(self, points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """(N,) points within ε of a box."""
        within = np.ones(len(points), bool)
        for axis in range(3):
            within &= points[:, axis] >= low[axis] - self.distance
            within &= points[:, axis] <= high[axis] + self.distance
        return within

    def _counting_rings(self, crossings: Crossings) -> np.ndarray:
        """(R,) rings that mean contact: of those of one part, or within each other, the one that cuts off most.

        It is the first that the part went through: the outer wall of a cup, not the inner.
        """
        n = crossings.n_rings
        votes = np.zeros((n, 256), int)
        skin = self._skin[crossings.body_faces]
        np.add.at(votes, (crossings.body_face_ring[skin], self.face_parts[crossings.body_faces[skin]]), 1)
        part, counting = votes.argmax(1), votes.any(1)  # not those that cut lids alone
        if n < 2:
            return counting
        size, beyond = self._cut_off(crossings)
        on_skin = counting.copy()
        counting[:] = False
        for ring in np.argsort(-size, kind="stable"):
            if not on_skin[ring]:
                continue
            larger = counting.nonzero()[0]
            within = beyond[ring].any() & ~(beyond[ring] & ~beyond[larger]).any(1)
            counting[ring] = not (within | (part[larger] == part[ring])).any()
        return counting

    def _cut_off(self, crossings: Crossings) -> tuple[np.ndarray, np.ndarray]:
        """What each ring by itself cuts off from the bulk of the body.

        Returns:
            size (R,): its vertices, and the share of the cut edges that belongs to it, which is below one and tells
            rings apart between which no vertex lies. beyond (R, regions): which regions it consists of.
        """
        own = ~crossings.of_object
        edge, ring, along = crossings.edge[own], crossings.ring[own], crossings.along[own]
        uncut = np.ones(len(self.body.edges), bool)
        uncut[edge] = False
        n_regions, region = _components(len(self.body.vertices), self.body.edges[uncut])
        n_vertices = np.bincount(region, minlength=n_regions)
        ends = region[self.body.edges[edge]]
        # The bulk of each connected surface is its largest region.
        _, surface = _components(n_regions, ends)
        order = np.argsort(n_vertices, kind="stable")
        bulk = np.zeros(surface.max() + 1, int)
        bulk[surface[order]] = order
        size, beyond = np.zeros(crossings.n_rings), np.zeros((crossings.n_rings, n_regions), bool)
        for k in range(crossings.n_rings):
            of_ring = np.isin(edge, edge[ring == k])
            _, side = _components(n_regions, ends[~of_ring])
            beyond[k] = side != side[bulk[surface]]
            lower, upper = beyond[k][ends[ring == k]].T
            share = np.where(lower, along[ring == k], 1 - along[ring == k])[lower != upper]
            size[k] = n_vertices[beyond[k]].sum() + (share.mean() if len(share) else 0)
        return size, beyond

    def _enclosed(self, crossings: Crossings, counting: np.ndarray) -> np.ndarray:
        """(V of the object,) vertices inside the body within the counting rings: found from the rings inwards."""
        own = crossings.of_object.nonzero()[0]
        own = own[np.lexsort((crossings.along[own], crossings.edge[own]))]
        edge = crossings.edge[own]
        first, last = np.ones(len(own), bool), np.ones(len(own), bool)
        first[1:] = last[:-1] = edge[1:] != edge[:-1]
        # An edge starts inside if it first leaves the body, and ends inside if it last enters it.
        inside, outside = [], []
        for end, at, leads_in in ((0, own[first], False), (1, own[last], True)):
            at = at[counting[crossings.ring[at]]]
            ends, is_in = self.object_mesh.edges[crossings.edge[at], end], crossings.entering[at] == leads_in
            inside.append(ends[is_in])
            outside.append(ends[~is_in])
        inside, outside = np.concatenate(inside), np.concatenate(outside)
        reached = self._around.flood(inside, edge)
        if reached[outside].any():
            # Of a body turned inside out in places, as hands of networks are, edges contradict each other: most decide.
            uncut = np.ones(len(self.object_mesh.edges), bool)
            uncut[edge] = False
            n_regions, region = _components(len(reached), self.object_mesh.edges[uncut])
            votes = np.bincount(region[inside], minlength=n_regions) - np.bincount(region[outside], minlength=n_regions)
            reached &= votes[region] > 0
        return reached


def vertex_parts(weights: np.ndarray) -> np.ndarray:
    """(V, J) skinning weights of a whole body in SMPL-X's schema → (V,) uint8 contact labels, joint + 1 (ref. 1)."""
    return (np.asarray(weights).argmax(1) + 1).astype(np.uint8)


class _Neighbours:
    """Vertices joined by edges, for walking over a surface."""

    def __init__(self, n: int, edges: np.ndarray):
        ends = np.concatenate([edges, edges[:, ::-1]])
        order = np.argsort(ends[:, 0], kind="stable")
        self.start = np.searchsorted(ends[order, 0], np.arange(n + 1))
        self.other = ends[order, 1]
        self.edge = np.tile(np.arange(len(edges)), 2)[order]
        self.n_edges = len(edges)

    def flood(self, seeds: np.ndarray, barriers: np.ndarray) -> np.ndarray:
        """(V,) vertices that are reached from `seeds` without going along the edges `barriers`."""
        reached = np.zeros(len(self.start) - 1, bool)
        closed = np.zeros(self.n_edges, bool)
        closed[barriers] = True
        front = np.unique(seeds)
        while len(front):
            reached[front] = True
            counts = self.start[front + 1] - self.start[front]
            offset = np.arange(counts.sum()) - np.repeat(counts.cumsum() - counts, counts)
            at = np.repeat(self.start[front], counts) + offset
            others = self.other[at[~closed[self.edge[at]]]]
            front = np.unique(others[~reached[others]])
        return reached


def _components(n: int, edges: np.ndarray) -> tuple[int, np.ndarray]:
    graph = coo_matrix((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), (n, n))
    return connected_components(graph, directed=False)


def _barycentric(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(N, 3) weights of the corners (N, 3, 3) that make up points (N, 3) on the triangles."""
    a, b, c = np.moveaxis(triangles.astype(np.float64), 1, 0)
    u, v, w = b - a, c - a, points - a
    uu, uv, vv, wu, wv = ((x * y).sum(1) for x, y in ((u, u), (u, v), (v, v), (w, u), (w, v)))
    scale = np.maximum(uu * vv - uv * uv, 1e-30)
    second, third = (vv * wu - uv * wv) / scale, (uu * wv - uv * wu) / scale
    return np.stack([1 - second - third, second, third], 1).astype(np.float32)
