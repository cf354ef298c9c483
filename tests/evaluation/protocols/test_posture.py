"""Joints at and beyond their limits, and a hand through itself."""

from __future__ import annotations

import numpy as np
import torch

from grabnet.body.anatomy import FINGERS
from grabnet.evaluation.protocols.posture import Posture, joint_limits
from tests.evaluation.shapes import ball, posed, scene


def test_joint_limits(hand, labels):
    low, high = labels.anatomy.angle_limits.T
    angles = torch.stack([(low + high) / 2, high, high])
    angles[2, labels.anatomy.angle_names.index("ring_pip")] += np.deg2rad(12)
    angles[2, labels.anatomy.angle_names.index("pinky_dip")] += np.deg2rad(0.5)  # within the tolerance
    found = joint_limits(labels, labels.anatomy.hand_pose(angles).numpy())
    np.testing.assert_array_equal(found["violations"], [0, 0, 1])
    np.testing.assert_allclose(found["excess"], [0, 0, 12], atol=0.01)
    np.testing.assert_allclose(found["off_axis"], 0, atol=0.01)


def test_a_hand_through_itself(hand, labels):
    """The flat hand does not overlap itself; a fist bent through its own palm does."""
    flat = posed(hand)
    bent = posed(hand, **{f"{f}_{j}": 1.9 for f in FINGERS[1:] for j in ("mcp_flexion", "pip", "dip")})
    own = [Posture(labels)(scene(ball(0.03), hands))["self_volume"][0] for hands in (flat, bent)]
    assert own[0] < 0.02
    assert own[1] > 1
