"""Empty space between the parts of a mesh."""

from __future__ import annotations

import numpy as np

from grabnet.geometry.mesh import Mesh


def widest_gap(mesh: Mesh) -> float:
    """Thickness of the thickest empty slab that has faces on both sides; 0 where there is none.

    Slabs are looked for across the axes of the mesh's frame and those along which its vertices spread.
    """
    vertices = mesh.vertices.astype(np.float64) - mesh.centroid
    spread = np.linalg.eigh(vertices.T @ vertices)[1]
    widest = 0.0
    for heights in (vertices @ np.hstack([np.eye(3), spread])).T:
        of_faces = heights[mesh.faces]
        order = of_faces.min(1).argsort()
        reached = np.maximum.accumulate(of_faces.max(1)[order])
        widest = max(widest, float((of_faces.min(1)[order][1:] - reached[:-1]).max(initial=0)))
    return widest
