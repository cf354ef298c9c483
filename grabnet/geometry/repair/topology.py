"""Which faces are at the same place, and which meet at an edge."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components


def places(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3) int64 faces by place: corners at the same one have the same number."""
    flat = np.ascontiguousarray(vertices, np.float32) + 0.0  # -0 and 0 are the same place
    _, place = np.unique(flat.view("V12").ravel(), return_inverse=True)
    return place[faces].astype(np.int64)


class Edges(NamedTuple):
    """Edges of faces (F, 3) that are given by place.

    Attributes:
        number: (3 F,) int64 of the edge that each side of a face runs along, face by face.
        forward: (3 F,) whether from its lower place to its higher one.
        uses: (E,) sides that run along each edge, either way.
    """

    number: np.ndarray
    forward: np.ndarray
    uses: np.ndarray

    @classmethod
    def of(cls, faces: np.ndarray) -> Edges:
        start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
        keys = np.minimum(start, end) * (faces.max(initial=0) + 1) + np.maximum(start, end)
        _, number, uses = np.unique(keys, return_inverse=True, return_counts=True)
        return cls(number, start < end, uses)

    @property
    def faces(self) -> np.ndarray:
        """(3 F,) the face of each side."""
        return np.arange(len(self.number)) // 3

    def linked(self) -> np.ndarray:
        """(F,) number of the part that each face hangs together in, by any edges."""
        n_faces = len(self.number) // 3
        size = n_faces + len(self.uses)
        links = coo_matrix((np.ones(len(self.number), bool), (self.faces, n_faces + self.number)), (size, size))
        return connected_components(links, directed=False)[1][:n_faces]

    def sides(self) -> np.ndarray:
        """(P, 2) sides that run along one edge, no third one there."""
        order = np.argsort(self.number, kind="stable")
        return order[self.uses[self.number[order]] == 2].reshape(-1, 2)

    def pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """(P, 2) faces that meet at an edge, no third one there, and (P,) whether they run along it opposite ways."""
        sides = self.sides()
        return self.faces[sides], self.forward[sides[:, 0]] != self.forward[sides[:, 1]]
