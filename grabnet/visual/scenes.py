"""Scenes in glTF, which is y-up and in metres whatever its meshes are (specification 2.0, section 3.4)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import trimesh

_Z_UP_TO_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def glb(parts: Mapping[str, trimesh.Trimesh], to_metres: np.ndarray) -> bytes:
    """A .glb file of parts, each a node of its name; their data are as given.

    Args:
        parts: in one frame and units.
        to_metres: (4, 4) from these to metres, z up. With the turn to y up it is the node "metres_y_up" above them.
    """
    scene = trimesh.Scene()
    scene.graph.update(frame_from=scene.graph.base_frame, frame_to="metres_y_up", matrix=_Z_UP_TO_Y_UP @ to_metres)
    for name, part in parts.items():
        scene.add_geometry(part, node_name=name, geom_name=name, parent_node_name="metres_y_up")
    return scene.export(file_type="glb")
