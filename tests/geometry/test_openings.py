import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from grabnet.geometry.mesh import Mesh
from grabnet.geometry.openings import boundary_loops, close


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
    """Right, left and turned inside out."""
    for faces in (hand.faces.numpy(), hand.faces.flip(1).numpy()):
        vertices, closed = close(hand.v_template[None].numpy(), faces)
        assert Mesh(vertices[0], closed).is_closed
        assert len(vertices[0]) == len(hand.v_template) + 1


def test_a_closed_mesh_stays_as_it_is():
    box = trimesh.creation.box()
    assert boundary_loops(box.faces) == []
    vertices, faces = close(box.vertices[None], box.faces)
    np.testing.assert_array_equal(vertices[0], box.vertices)
    np.testing.assert_array_equal(faces, box.faces)


def test_openings_that_touch_are_refused():
    """Two triangles that share a corner only: its boundary runs through it twice."""
    with pytest.raises(ValueError, match="simple loops"):
        boundary_loops(np.array([[0, 1, 2], [0, 3, 4]]))
