"""Keypoints of hands."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from grabnet.evaluation.hands import Hands
from tests.evaluation.shapes import posed


def test_keypoints_do_not_depend_on_where_the_hand_is(hand, labels):
    flat = posed(hand, index_pip=0.7, thumb_cmc_flexion=0.3)
    turn = trimesh.transformations.random_rotation_matrix(np.array([0.2, 0.7, 0.4]))[:3, :3]
    elsewhere = Hands(vertices=(flat.vertices @ turn.T + 0.3).astype(np.float32), faces=flat.faces)
    here, there = labels.keypoints(flat), labels.keypoints(elsewhere)
    np.testing.assert_allclose(here, there, atol=1e-6)
    np.testing.assert_allclose(here[0, 0], 0, atol=1e-9)
    np.testing.assert_allclose(here[0, 4, 1:], 0, atol=1e-9)  # the middle knuckle along x
    assert np.linalg.norm(here[0, 4]) == pytest.approx(
        np.linalg.norm(hand.rest_joints(hand.v_template)[4] - hand.rest_joints(hand.v_template)[0]), rel=0.05
    )
