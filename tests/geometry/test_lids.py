"""Surfaces with openings are closed by their lids; closed ones stay as they are."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from grabnet.body.hand import HandModel
from grabnet.geometry.lids import Lids
from grabnet.geometry.mesh import Mesh


def closed(vertices, faces):
    lids = Lids(len(vertices), faces)
    return Mesh(lids.with_middles(vertices), np.concatenate([faces, lids.faces])), lids


def test_a_closed_surface_has_no_lid():
    ball = trimesh.creation.icosphere(2)
    mesh, lids = closed(ball.vertices, ball.faces)
    assert lids.n == 0 and len(lids.faces) == 0 and len(mesh.vertices) == len(ball.vertices)


def test_a_pipe_has_two_flat_lids():
    pipe = trimesh.creation.cylinder(0.03, 0.1, sections=40)
    side = np.abs(pipe.face_normals[:, 2]) < 0.5
    mesh, lids = closed(np.asarray(pipe.vertices), pipe.faces[side])
    assert lids.n == 2 and mesh.is_closed
    assert mesh.volume == pytest.approx(pipe.volume, rel=1e-5)
    np.testing.assert_allclose(sorted(mesh.vertices[-2:].tolist()), [[0, 0, -0.05], [0, 0, 0.05]], atol=1e-6)


def test_the_hand_has_one_opening_wherever_it_moves():
    hand = HandModel.open()
    vertices = hand.v_template.numpy()
    mesh, lids = closed(vertices, hand.faces.numpy())
    assert lids.n == 1 and len(lids.faces) == 16 and mesh.is_closed and mesh.volume > 0
    np.testing.assert_allclose(lids.with_middles(vertices + 1)[-1], mesh.vertices[-1] + 1, atol=1e-6)


def test_holes_that_meet_in_a_vertex_are_closed():
    ball = trimesh.creation.icosphere(2)
    at = ball.vertex_faces[0][ball.vertex_faces[0] >= 0]
    faces = np.delete(ball.faces, [at[0], at[2]], 0)  # two faces that share vertex 0 and nothing else
    mesh, _ = closed(np.asarray(ball.vertices), faces)
    start, end = mesh.faces.ravel(), np.roll(mesh.faces, -1, 1).ravel()
    forward, backward = sorted(zip(start, end, strict=True)), sorted(zip(end, start, strict=True))
    assert forward == backward
