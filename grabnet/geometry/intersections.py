"""Where two surfaces cut through each other: exactly which edges pass which faces, joined to rings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
import warp as wp
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from grabnet.geometry.kernels import intersections as kernels
from grabnet.geometry.kernels import queries
from grabnet.geometry.kernels.launch import launch


class MovingMesh:
    """A surface of fixed faces whose vertices move, with its edges and a tree for queries on the CPU.

    Args:
        vertices: (V, 3) float32, the first position. faces: (F, 3) int.

    Attributes:
        edges: (E, 2) int64, each once, the lower vertex first. face_edges: (F, 3) into them; number k of a face joins
            its corners k and k + 1.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        self.faces = np.ascontiguousarray(faces, np.int32)
        self._corners = np.ascontiguousarray(self.faces.T)
        corners = np.stack([self.faces, np.roll(self.faces, -1, 1)], -1).astype(np.int64)
        self.edges, inverse = np.unique(np.sort(corners, -1).reshape(-1, 2), axis=0, return_inverse=True)
        self.face_edges = np.ascontiguousarray(inverse.reshape(-1, 3), np.int32)
        self.vertices = np.ascontiguousarray(vertices, np.float32)
        self.mesh = wp.Mesh(
            wp.array(self.vertices, dtype=wp.vec3, device="cpu"),
            wp.array(self.faces.flatten(), dtype=wp.int32, device="cpu"),
        )
        self.surface = kernels.Surface()
        self.surface.points = self.mesh.points
        self.surface.faces = wp.array(self.faces, dtype=int, device="cpu")
        self.surface.face_edges = wp.array(self.face_edges, dtype=int, device="cpu")

    def move(self, vertices: np.ndarray) -> None:
        """Put the vertices (V, 3) elsewhere."""
        self.vertices = np.ascontiguousarray(vertices, np.float32)
        self.mesh.points.assign(self.vertices)
        self.mesh.refit()
        self.__dict__.pop("bounds", None)

    def faces_near(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Numbers (N,) of the faces whose bounding boxes meet the box from `low` to `high`."""
        # A face misses the box if its corners lie beyond the same side of it.
        beyond = np.zeros(len(self.vertices), np.uint8)
        for axis in range(3):
            beyond |= (self.vertices[:, axis] < low[axis]) * np.uint8(1 << axis)
            beyond |= (self.vertices[:, axis] > high[axis]) * np.uint8(8 << axis)
        a, b, c = self._corners
        return (beyond[a] & beyond[b] & beyond[c] == 0).nonzero()[0]

    def closest(
        self, points: np.ndarray, max_distance: float = 1e3, faces: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Face (N,), -1 beyond `max_distance`, and position (N, 3) nearest to each point, among the chosen `faces`."""
        points = torch.from_numpy(np.ascontiguousarray(points, np.float32))
        face = torch.full((len(points),), -1, dtype=torch.int32)
        position, distance = torch.zeros_like(points), torch.zeros(len(points))
        items = [points, distance, position, face]
        if len(points) and faces is None:
            launch(queries.closest_point, items, [self.mesh.id, max_distance])
        elif len(points):
            launch(queries.closest_of_faces, items, [self.mesh.id, max_distance, torch.from_numpy(faces)])
        return face.numpy(), position.numpy()

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner."""
        return self.vertices.min(0), self.vertices.max(0)


@dataclass(frozen=True)
class Crossings:
    """Points where an edge of one surface passes a face of the other, N of them, and the R rings that they form.

    Where two faces cut through each other they share a segment between two such points; points joined by segments make
    a ring. Two rings are never taken for one because they pass the same large face.

    Attributes:
        of_object: (N,) bool, whether the edge is the object's and the face the body's, or the other way round.
        edge, face: (N,) which edge of the one and which face of the other.
        along: (N,) share of the way from the edge's lower vertex to the other at which it passes.
        entering: (N,) whether that way leads from the front of the face to its back, into the solid.
        ring: (N,) in 0 … R - 1.
        body_faces, body_face_ring: (M,) body faces that are cut, once for each ring that cuts them.
        n_rings: R.
    """

    of_object: np.ndarray
    edge: np.ndarray
    face: np.ndarray
    along: np.ndarray
    entering: np.ndarray
    ring: np.ndarray
    body_faces: np.ndarray
    body_face_ring: np.ndarray
    n_rings: int


def find_crossings(body: MovingMesh, thing: MovingMesh) -> Crossings:
    """All crossings of the body's surface with the object's; exact but for points in one plane to the last bit."""
    near = body.faces_near(*thing.bounds).astype(np.int32)
    hits = _hits(body, thing, torch.from_numpy(near))
    # The faces on both sides of an edge find the same crossing.
    key = (hits["edge"].astype(np.int64) * (max(len(body.faces), len(thing.faces)) + 1) + hits["face"]) * 2
    key += hits["of_object"]
    _, first, point = np.unique(key, return_index=True, return_inverse=True)
    pair = hits["body_face"].astype(np.int64) * len(thing.faces) + hits["object_face"]
    order = np.argsort(pair, kind="stable")
    same = pair[order[1:]] == pair[order[:-1]]
    links = point[order[:-1]][same], point[order[1:]][same]
    n = len(first)
    graph = coo_matrix((np.ones(len(links[0]), bool), links), (n, n))
    n_rings, ring = connected_components(graph, directed=False) if n else (0, np.zeros(0, np.int32))
    cut = np.unique(np.stack([hits["body_face"], ring[point]], 1), axis=0) if n else np.zeros((0, 2), int)
    return Crossings(
        *(hits[name][first] for name in ("of_object", "edge", "face", "along", "entering")),
        ring,
        cut[:, 0],
        cut[:, 1],
        n_rings,
    )


_HITS = {
    "of_object": torch.bool, "edge": torch.int32, "face": torch.int32, "body_face": torch.int32,
    "object_face": torch.int32, "along": torch.float32, "entering": torch.bool,
}  # fmt: skip


def _hits(body: MovingMesh, thing: MovingMesh, body_faces: Tensor) -> dict[str, np.ndarray]:
    """Crossings by pair of faces; counted first, so that threads know where to write."""
    low, high = (wp.vec3(*map(float, corner)) for corner in thing.bounds)
    start, count = torch.zeros_like(body_faces), torch.zeros_like(body_faces)

    def run(fill: bool, n: int) -> dict[str, Tensor]:
        values = {name: torch.empty(n, dtype=dtype) for name, dtype in _HITS.items()}
        hits = kernels.Hits()
        for name, value in values.items():
            setattr(hits, name, wp.from_torch(value, dtype=kernels.Hits.vars[name].type.dtype))
        constants = [body.surface, thing.surface, thing.mesh.id, low, high, fill, hits]
        launch(kernels.find_crossings, [body_faces, start, count], constants)
        return values

    if len(body_faces):
        run(False, 0)
        start[1:] = count.cumsum(0)[:-1]
    n = int(count.sum())
    values = run(True, n) if n else {name: torch.empty(0, dtype=dtype) for name, dtype in _HITS.items()}
    return {name: value.numpy() for name, value in values.items()}
