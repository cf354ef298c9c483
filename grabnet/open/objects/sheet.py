"""A picture of all open objects, to look at."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from grabnet.geometry.mesh import Mesh, load_mesh
from grabnet.visual.pictures import Shape, contact_sheet, render


def objects_sheet(paths: list[Path], tile: int = 160, columns: int = 9) -> np.ndarray:
    """Every mesh filling its tile, captioned with its name and the sides of its box; uint8 (H, W, 3)."""
    meshes = [load_mesh(path) for path in paths]
    tiles = [render([Shape(mesh.vertices, mesh.faces)], (0.55, -1.0, 0.6), size=(tile, tile)) for mesh in meshes]
    return contact_sheet(tiles, [f"{p.stem}, {_sides(m)}" for p, m in zip(paths, meshes, strict=True)], columns)


def _sides(mesh: Mesh) -> str:
    return "x".join(f"{100 * side:.0f}" for side in mesh.extents) + " cm"
