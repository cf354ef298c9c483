"""How much of an object's surface a hand lies against (ref. 9, `volco`)."""

from __future__ import annotations

import numpy as np

from grabnet.geometry.intersections import MovingMesh
from grabnet.geometry.mesh import Mesh

REACH = 0.005  # metres


class ContactArea:
    """Area of the object's faces that have a corner within 5 mm of the hand, and look against the skin there.

    The skin is looked at where it is nearest to that corner. A hand inside the object is near it no less than outside.

    Args:
        mesh: the object, metres. Its faces count as wholes, however large.
    """

    def __init__(self, mesh: Mesh):
        self.vertices, self.faces = mesh.vertices, mesh.faces
        a, b, c = np.moveaxis(mesh.vertices[mesh.faces].astype(np.float64), 1, 0)
        normals = np.cross(b - a, c - a) / 2 * (1 if mesh.volume >= 0 else -1)
        self.area = np.linalg.norm(normals, axis=1)
        self.normals = normals

    def __call__(self, hand: MovingMesh) -> float:
        """Return m², of a hand open at the wrist."""
        low, high = hand.bounds
        near = ((self.vertices > low - REACH) & (self.vertices < high + REACH)).all(1).nonzero()[0]
        face, _ = hand.closest(self.vertices[near], REACH)
        near, face = near[face >= 0], face[face >= 0]
        a, b, c = np.moveaxis(hand.vertices[hand.faces[face]].astype(np.float64), 1, 0)
        skin_normals = np.zeros((len(self.vertices), 3))
        skin_normals[near] = np.cross(b - a, c - a)
        against = np.einsum("fci,fi->fc", skin_normals[self.faces], self.normals).min(1) < 0
        return float(self.area[against].sum())
