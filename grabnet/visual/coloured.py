"""glTF of one mesh in several colourings."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from grabnet.visual.glb_file import ARRAY, INDICES, MATERIAL, Z_UP_TO_Y_UP, GlbFile


def coloured_glb(vertices: np.ndarray, faces: np.ndarray, colours: Mapping[str, np.ndarray], up: str = "z") -> bytes:
    """A .glb file with a mesh for each colouring; they share positions and faces.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3).
        colours: (V, 3) uint8, by the name of the mesh.
        up: axis that points upwards, "y" or "z"; the file is y up.
    """
    file = GlbFile()
    position = file.array(vertices.astype(np.float32), ARRAY, bounds=True)
    corners = file.array(faces.astype(np.uint32).reshape(-1, 1), INDICES)
    opaque = np.full((len(vertices), 1), 255, np.uint8)
    meshes = []
    for name, colour in colours.items():
        color = file.array(np.concatenate([colour, opaque], 1), ARRAY, normalized=True)
        attributes = {"POSITION": position, "COLOR_0": color}
        meshes.append({"name": name, "primitives": [{"attributes": attributes, "indices": corners, "material": 0}]})
    root = {"name": "metres_y_up", "children": list(range(1, len(meshes) + 1))}
    nodes = [root | ({"matrix": Z_UP_TO_Y_UP} if up == "z" else {})]
    nodes += [{"name": mesh["name"], "mesh": k} for k, mesh in enumerate(meshes)]
    scenes = [{"nodes": [0]}]
    return file.packed({"scene": 0, "scenes": scenes, "nodes": nodes, "meshes": meshes, "materials": [MATERIAL]})
