"""Balls and boxes in the place of objects and hands: their overlap has closed forms."""

from __future__ import annotations

import numpy as np
import trimesh

from grabnet.evaluation.hands import Hands
from grabnet.evaluation.scene import Scene, Target
from grabnet.geometry.mesh import Mesh


def ball(radius: float, subdivisions: int = 4) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions, radius)
    return Mesh(made.vertices, made.faces)


def moved(mesh: Mesh, *offsets: tuple[float, float, float]) -> Hands:
    """The mesh as a hand in several places."""
    vertices = np.stack([mesh.vertices + np.array(offset, np.float32) for offset in offsets])
    return Hands(vertices=vertices.astype(np.float32), faces=mesh.faces.astype(np.int64))


def scene(mesh: Mesh, hands: Hands) -> Scene:
    return Scene(Target(mesh), hands)
