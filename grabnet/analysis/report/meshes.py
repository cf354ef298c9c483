"""Meshes coloured by the likelihood of contact, as files and for the page."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from grabnet.analysis.plots import difference_colours, heat_colours
from grabnet.analysis.statistic import Heats
from grabnet.io.files import write_bytes
from grabnet.visual.coloured import coloured_glb
from grabnet.visual.pictures import Shape
from grabnet.visual.turntable import thinned

# Faces of a mesh in the page, at most: it holds more than fifty.
_MOST_FACES = 16_000


class Coloured(NamedTuple):
    """A colouring: its values (V,), their (V, 3) uint8 colours, and the ends of its scale."""

    values: np.ndarray
    colours: np.ndarray
    low: float
    high: float
    is_change: bool


def colourings(heats: Heats) -> dict[str, Coloured]:
    """All of a mesh, by name: likelihoods from 0 to the highest of all, differences from the lowest to its negative."""
    found = {}
    for values, paint, is_change in ((heats.shares, heat_colours, False), (heats.changes, difference_colours, True)):
        most = max((float(np.abs(v).max()) for v in values.values()), default=0.0)
        for name, v in values.items():
            colours = (255 * paint(v, most)).round().astype(np.uint8)
            found[name] = Coloured(v, colours, -most if is_change else 0.0, most, is_change)
    return found


def write_heats(folder: Path, name: str, heats: Heats) -> None:
    """Write a PLY file of each colouring, with the property `likelihood`, or `difference`."""
    for what, each in colourings(heats).items():
        solid = trimesh.Trimesh(heats.vertices, heats.faces, vertex_colors=each.colours, process=False)
        solid.vertex_attributes["difference" if each.is_change else "likelihood"] = each.values.astype(np.float32)
        words = f"{name} {what}".replace("−", "minus").replace(",", "").split()
        write_bytes(folder / f"{'_'.join(words)}.ply", solid.export(file_type="ply"))


def heats_glb(heats: Heats) -> bytes:
    """A .glb file with a mesh for each colouring; of fewer faces than the files where there are many."""
    fewer = thinned(Shape(heats.vertices, heats.faces), _MOST_FACES)
    nearest = cKDTree(heats.vertices).query(fewer.vertices)[1]
    colours = {name: each.colours[nearest] for name, each in colourings(heats).items()}
    return coloured_glb(fewer.vertices, fewer.faces, colours, heats.up)
