"""Depth of a box in a slab."""

from __future__ import annotations

import numpy as np
import trimesh

from grabnet.evaluation.protocols.penetration import Penetration
from grabnet.geometry.mesh import Mesh
from tests.evaluation.shapes import moved, scene


def test_mean_depth_is_over_the_vertices_inside():
    """A box pushed 4 mm into a wide slab: the four corners of one face are in, all at that depth."""
    slab, box = trimesh.creation.box((0.2, 0.2, 0.02)), trimesh.creation.box((0.02, 0.02, 0.04))
    hands = moved(Mesh(box.vertices, box.faces), (0, 0, 0.01 + 0.02 - 0.004), (0, 0, 0.05))
    found = Penetration()(scene(Mesh(slab.vertices, slab.faces), hands))
    np.testing.assert_allclose(found["max"], [4, 0], atol=1e-3)
    np.testing.assert_allclose(found["mean"], [4, 0], atol=1e-3)
