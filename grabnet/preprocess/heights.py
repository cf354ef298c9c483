"""How high above its table an object is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from grabnet.data.sequences import RigidTrack
from grabnet.geometry.mesh import Mesh


def gap_to_table(thing: RigidTrack, mesh: Mesh, table: RigidTrack, table_mesh: Mesh) -> np.ndarray:
    """(T,) metres from the table's highest point up to the object's lowest, negative below it.

    Unlike the height of the object's origin it stays zero while the object is turned or tipped on the table.
    """
    return _extreme(thing, mesh, np.min) - _extreme(table, table_mesh, np.max)


def _extreme(track: RigidTrack, mesh: Mesh, extreme: Callable[[np.ndarray], float]) -> np.ndarray:
    """(T,) lowest or highest coordinate along z of the moving vertices."""
    vertical = track.rotations()[:, 2].numpy()  # what each axis of the mesh adds to the height
    heights = [extreme(mesh.vertices @ direction) for direction in vertical]
    return np.array(heights, np.float32) + track.transl[:, 2]
