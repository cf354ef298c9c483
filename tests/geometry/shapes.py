"""Solids whose signed distance is known in closed form, with meshes of them. All centred at the origin, metres."""

import numpy as np
import trimesh

from grabnet.geometry.mesh import Mesh


def mesh_of(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(solid.vertices, solid.faces)


def sphere(radius: float = 0.04) -> Mesh:
    return mesh_of(trimesh.creation.icosphere(subdivisions=5, radius=radius))


def sphere_distance(p: np.ndarray, radius: float = 0.04) -> np.ndarray:
    return np.linalg.norm(p, axis=-1) - radius


def box(sides: tuple[float, float, float] = (0.12, 0.05, 0.02)) -> Mesh:
    return mesh_of(trimesh.creation.box(sides))


def box_distance(p: np.ndarray, sides: tuple[float, float, float] = (0.12, 0.05, 0.02)) -> np.ndarray:
    q = np.abs(p) - np.array(sides) / 2
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)


def torus(major: float = 0.04, minor: float = 0.012) -> Mesh:
    return mesh_of(trimesh.creation.torus(major, minor, major_sections=256, minor_sections=96))


def torus_distance(p: np.ndarray, major: float = 0.04, minor: float = 0.012) -> np.ndarray:
    ring = np.linalg.norm(p[..., :2], axis=-1) - major
    return np.hypot(ring, p[..., 2]) - minor


def capsule(radius: float = 0.012, length: float = 0.1) -> Mesh:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius).vertices
    ends = [ball[ball[:, 2] * side >= 0] + [0, 0, side * length / 2] for side in (-1, 1)]
    return mesh_of(trimesh.convex.convex_hull(np.concatenate(ends)))


def capsule_distance(p: np.ndarray, radius: float = 0.012, length: float = 0.1) -> np.ndarray:
    axis = np.zeros_like(p)
    axis[..., 2] = p[..., 2].clip(-length / 2, length / 2)
    return np.linalg.norm(p - axis, axis=-1) - radius


CLOSED_FORMS = {
    "sphere": (sphere, sphere_distance),
    "box": (box, box_distance),
    "torus": (torus, torus_distance),
    "capsule": (capsule, capsule_distance),
}


def cup(radius: float = 0.04, height: float = 0.1) -> Mesh:
    """A cup of infinitely thin wall, open at the top: floor at -height/2."""
    cylinder = trimesh.creation.cylinder(radius, height, sections=96)
    lid = cylinder.face_normals[:, 2] > 0.9
    return Mesh(cylinder.vertices, cylinder.faces[~lid])
