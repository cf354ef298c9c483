"""Meshes coloured by the likelihood of contact, as files and for the page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from grabnet.analysis.plots import heat_colours
from grabnet.analysis.statistic import Heat
from grabnet.io.files import write_bytes
from grabnet.visual.scenes import glb

Y_UP_TO_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


def write_heat(path: Path, heat: Heat) -> None:
    """Write a PLY file, coloured from 0 to the mesh's highest likelihood, with the property `likelihood`."""
    solid = _coloured(heat)
    solid.vertex_attributes["likelihood"] = heat.share.astype(np.float32)
    write_bytes(path, solid.export(file_type="ply"))


def heat_glb(heat: Heat) -> bytes:
    """A .glb file with vertex colours, y up."""
    return glb({"heat": _coloured(heat)}, Y_UP_TO_Z_UP if heat.up == "y" else np.eye(4))


def _coloured(heat: Heat) -> trimesh.Trimesh:
    colours = (255 * heat_colours(heat.share, float(heat.share.max()))).round().astype(np.uint8)
    return trimesh.Trimesh(heat.vertices, heat.faces, vertex_colors=colours, process=False)
