"""Fingers that touch, and with how much skin."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from grabnet.body.anatomy import FINGERS
from grabnet.evaluation.protocols.contact import PARTS, FingerContact, vertex_areas
from grabnet.evaluation.protocols.posture import Posture
from grabnet.geometry.mesh import Mesh
from tests.evaluation.shapes import EPSILON, ball, moved, posed, scene


def test_fingers_that_touch(hand, labels):
    """A small ball at the tip of the index finger, and a large one around the whole hand."""
    flat = posed(hand)
    tip = flat.vertices[0, labels.anatomy.tips[FINGERS.index("index")]]
    small = Mesh(ball(0.002).vertices + tip, ball(0.002).faces)
    found = FingerContact(labels, 0.001)(scene(small, flat))
    assert [found[f"touches_{p}"][0] for p in PARTS] == [p == "index" for p in PARTS]
    assert found["fingers"] == 1
    assert found["pinched"] == 0
    assert 0 < found["area"][0] == found["area_index"][0] < 1

    around = FingerContact(labels, 0.001)(scene(ball(0.5), flat))
    assert around["fingers"] == 5
    assert around["pinched"] == 1
    skin = 1e4 * trimesh.Trimesh(flat.vertices[0], flat.faces, process=False).area
    assert around["area"][0] == pytest.approx(skin, rel=1e-5)
    assert sum(around[f"area_{p}"][0] for p in PARTS) == pytest.approx(skin, rel=1e-5)


def test_definitions_give_the_distance_that_is_set(labels):
    (definition,) = (m.about for m in FingerContact(labels, 0.003).metrics if m.name == "area")
    assert definition == "skin inside the object or within 3 mm of it"


def test_vertex_areas_share_out_the_surface():
    box = trimesh.creation.box((1, 2, 3)).subdivide()
    areas = vertex_areas(np.stack([box.vertices, 2 * box.vertices]), box.faces)
    np.testing.assert_allclose(areas.sum(1), [22, 88])


def test_meshes_of_other_hands_give_what_does_not_need_fingers(labels):
    found = FingerContact(labels, EPSILON)(scene(ball(0.03), moved(ball(0.02), (0.04, 0, 0))))
    assert found["area"][0] > 0
    assert np.isnan(found["fingers"][0])
    assert labels.keypoints(moved(ball(0.02), (0, 0, 0))) is None
    assert np.isnan(Posture(labels)(scene(ball(0.03), moved(ball(0.02), (0, 0, 0))))["violations"][0])
