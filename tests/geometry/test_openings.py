import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from grabnet.geometry.mesh import Mesh
from grabnet.geometry.openings import Lids, boundary_loops, close


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**31))
def test_a_ball_with_holes_is_closed_again(seed):
    """As many loops as separate faces are taken away, and the volume is back but for the flattened caps."""
    ball = trimesh.creation.icosphere(3)
    chosen = np.random.default_rng(seed).permutation(len(ball.faces))
    removed, touched = [], set()
    for face in chosen:
        if not touched & set(ball.faces[face]):
            removed.append(face)
            touched |= set(ball.faces[face])
        if len(removed) == 4:
            break
    faces = np.delete(ball.faces, removed, axis=0)
    loops = boundary_loops(faces)
    assert sorted(map(sorted, loops)) == sorted(sorted(ball.faces[f]) for f in removed)
    vertices, closed = close(ball.vertices[None], faces)
    mesh = Mesh(vertices[0], closed)
    assert mesh.is_closed
    assert mesh.volume == pytest.approx(ball.volume, rel=1e-5)
    np.testing.assert_array_equal(closed[: len(faces)], faces)
    np.testing.assert_array_equal(vertices[0, : len(ball.vertices)], ball.vertices)


def test_the_wrist_of_any_hand_is_closed(hand):
    """Right, left and turned inside out; many at once as one by one."""
    for faces in (hand.faces.numpy(), hand.faces.flip(1).numpy()):
        hands = hand.v_template.numpy() * np.array([1, -2, 3], np.float32)[:, None, None]
        vertices, closed = close(hands, faces)
        assert vertices.dtype == np.float32 and closed.dtype == faces.dtype
        assert vertices.shape == (3, len(hand.v_template) + 1, 3) and len(closed) == len(faces) + 16
        for one, before in zip(vertices, hands, strict=True):
            assert Mesh(one, closed).is_closed
            np.testing.assert_array_equal(one, close(before, faces)[0])
        np.testing.assert_allclose(vertices[:, -1], hands[:, boundary_loops(faces)[0]].mean(1), atol=1e-6)


def test_a_closed_hand_faces_outwards(hand):
    vertices, faces = close(hand.v_template.numpy(), hand.faces.numpy())
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert 2e-4 < mesh.volume < 5e-4  # cubic metres: a hand is 200 to 500 cm³
    forearm = vertices[-1] - vertices.mean(0)
    assert (mesh.face_normals[len(hand.faces) :] @ forearm > 0).all()


def test_a_pipe_has_two_flat_lids():
    pipe = trimesh.creation.cylinder(0.03, 0.1, sections=40)
    side = np.abs(pipe.face_normals[:, 2]) < 0.5
    vertices, faces = close(np.asarray(pipe.vertices), pipe.faces[side])
    mesh = Mesh(vertices, faces)
    assert mesh.is_closed and mesh.volume == pytest.approx(pipe.volume, rel=1e-5)
    np.testing.assert_allclose(sorted(vertices[-2:].tolist()), [[0, 0, -0.05], [0, 0, 0.05]], atol=1e-6)


def test_a_closed_mesh_stays_as_it_is():
    box = trimesh.creation.box()
    assert boundary_loops(box.faces) == []
    assert Lids(len(box.vertices), box.faces).n == 0
    vertices, faces = close(box.vertices, box.faces)
    np.testing.assert_array_equal(vertices, box.vertices)
    np.testing.assert_array_equal(faces, box.faces)


def test_loops_follow_the_faces():
    (loop,) = boundary_loops(np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4]]))
    assert loop.tolist() == [0, 1, 2, 3, 4]


def test_openings_that_touch_have_no_simple_loops():
    """Two triangles that share a corner only: its boundary runs through it twice."""
    with pytest.raises(ValueError, match="simple loops"):
        boundary_loops(np.array([[0, 1, 2], [0, 3, 4]]))


def test_openings_that_touch_are_closed():
    ball = trimesh.creation.icosphere(2)
    at = ball.vertex_faces[0][ball.vertex_faces[0] >= 0]
    faces = np.delete(ball.faces, [at[0], at[2]], 0)  # two faces that share vertex 0 and nothing else
    _, closed = close(np.asarray(ball.vertices), faces)
    start, end = closed.ravel(), np.roll(closed, -1, 1).ravel()
    assert sorted(zip(start, end, strict=True)) == sorted(zip(end, start, strict=True))
