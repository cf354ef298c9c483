"""Faces that do not agree on which side is inside: double ones dropped, others turned.

Inside is where the winding number says so (`MeshQuery`); a face that looks the wrong way, or that is there twice, makes
it wrong.
Meshes whose faces agree stay as they are: closed or open, of parts that overlap or touch, and with cavities.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from grabnet.geometry.repair.doubles import without_doubles
from grabnet.geometry.repair.orientation import wrong_way
from grabnet.geometry.repair.topology import places


class Mended(NamedTuple):
    """Faces (F, 3), in the order given, and a phrase for each kind of repair."""

    faces: np.ndarray
    repairs: tuple[str, ...]


def mended(vertices: np.ndarray, faces: np.ndarray) -> Mended:
    """Faces that agree on which side is outside; those that are lines or points stay as they are.

    Args:
        vertices: (V, 3); those at one place count as one.
        faces: (F, 3) of them.

    Raises:
        UndecidedError: a surface that does not tell, such as a strip with a twist.
    """
    by_place = places(vertices, faces)
    sound = np.flatnonzero((by_place != np.roll(by_place, 1, axis=1)).all(1))
    if not len(sound):
        return Mended(faces, ())
    corners = vertices[faces[sound]].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-300)
    kept, fins = without_doubles(by_place[sound], corners, normals)
    single = sound[kept & ~fins]
    turned = np.zeros(len(faces), bool)
    turned[single] = wrong_way(vertices, faces[single], by_place[single])
    repairs = []
    if dropped := int((~kept).sum()):
        repairs.append(f"dropped {dropped:,} of {len(faces):,} faces, which were there twice")
    if n := int(turned.sum()):
        repairs.append(f"turned {n:,} of {len(faces) - dropped:,} faces, which looked the wrong way")
    if not repairs:
        return Mended(faces, ())
    faces = np.where(turned[:, None], faces[:, ::-1], faces)
    return Mended(np.delete(faces, sound[~kept], axis=0), tuple(repairs))
