"""Contact maps of a hand with an open wrist."""

from __future__ import annotations

import numpy as np
import torch
import trimesh

from grabnet.evaluation.protocols.contact_maps import ContactMaps
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from tests.evaluation.shapes import EPSILON, posed, scene


def test_contact_stays_within_the_closed_wrist(hand, labels):
    """A rod that enters the hand through its open wrist and ends inside: only what is inside is touched."""
    flat = posed(hand)
    closed, faces = flat.closed
    wrist = closed[0, -1]
    inward = flat.vertices[0, labels.finger == -1].mean(0) - wrist
    inward /= np.linalg.norm(inward)
    rod = trimesh.creation.cylinder(0.003, segment=[wrist - 0.05 * inward, wrist + 0.015 * inward], sections=12)
    rod = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(rod.vertices, rod.faces, 0.003))
    solid = Mesh(rod.vertices, rod.faces)
    touched = ContactMaps(labels, EPSILON)(scene(solid, flat))["object"][0] > 0
    depth = -MeshQuery(Mesh(closed[0], faces)).signed_distance(torch.tensor(solid.vertices)).numpy()
    assert touched[depth > 1e-4].all()
    assert not touched[depth < -EPSILON].any()
    assert (depth > 1e-4).sum() > 20
