"""Meshes coloured by contact."""

from __future__ import annotations

import colorsys
from pathlib import Path

import numpy as np
import trimesh

from grabnet.body.skeleton import N_PARTS
from grabnet.geometry.mesh import Mesh
from grabnet.io.files import write_bytes

# (56, 3) uint8 colours of the labels: light grey for no contact, then hues far from those of neighbouring parts.
PART_COLOURS = np.array(
    [(205, 205, 205)]
    + [
        tuple(round(255 * c) for c in colorsys.hsv_to_rgb(part * 0.618034 % 1, 0.75, 0.9))
        for part in range(1, N_PARTS + 1)
    ],
    np.uint8,
)


def write_labelled(path: Path, mesh: Mesh, labels: np.ndarray) -> None:
    """Write a PLY file whose vertices have a colour by part and the property `contact`: the part, 0 for none.

    Args:
        path: of the file.
        mesh: in any frame and units.
        labels: (V,) uint8 contact labels (ref. 1).
    """
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=PART_COLOURS[labels], process=False)
    solid.vertex_attributes["contact"] = np.asarray(labels, np.uint8)
    write_bytes(path, solid.export(file_type="ply"))
