"""Overlap of open hands, open objects and large meshes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import trimesh

from grabnet.body.hand import HandModel
from grabnet.evaluation.hands import Hands
from grabnet.evaluation.protocols.halo import Halo
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.openings import boundary_loops
from tests.evaluation.shapes import ball, posed, scene


def test_an_open_hand_is_measured_as_the_closed_one(hand):
    """The volume of a hand within a block is that of its capped mesh, right or left or inside out."""
    block = trimesh.creation.box((0.4, 0.4, 0.4))
    solid = Mesh(block.vertices, block.faces)
    for model in (hand, HandModel.open("left")):
        flat = posed(model)
        fan = [[rim[0], b, a] for rim in boundary_loops(model.faces.numpy()) for a, b in pairwise(rim[1:])]
        expected = 1e6 * Mesh(flat.vertices[0], np.concatenate([flat.faces, fan])).volume
        assert Halo()(scene(solid, flat))["volume"][0] == pytest.approx(expected, rel=0.01)
        turned = Hands(vertices=flat.vertices, faces=flat.faces[:, ::-1].copy())
        assert Halo()(scene(solid, turned))["volume"][0] == pytest.approx(expected, rel=0.01)


def test_an_open_object_and_one_of_many_faces(hand, labels):
    """A bowl without a lid, and a ball of 327,680 faces."""
    flat = posed(hand)
    onto = Hands(vertices=flat.vertices - flat.vertices.mean(1, keepdims=True), faces=flat.faces)
    whole, many = ball(0.04, 3), ball(0.04, 7)
    bowl = Mesh(whole.vertices, whole.faces[whole.triangles.mean(1)[:, 2] < 0.02])
    assert not bowl.is_closed
    exact, fine, opened = (Halo(spacing=0.002)(scene(mesh, onto)) for mesh in (whole, many, bowl))
    assert fine["volume"][0] == pytest.approx(exact["volume"][0], rel=0.05)
    assert 0.4 * exact["volume"][0] < opened["volume"][0] < 1.1 * exact["volume"][0]
