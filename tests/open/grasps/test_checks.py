from __future__ import annotations

import torch

from grabnet.grasping.grasp_hand import GraspPose
from grabnet.grasping.proposing.posture import PostureConfig
from grabnet.grasping.proposing.proposals import Proposals
from grabnet.open.grasps.checks import AcceptanceConfig, measure, verdicts

from ...grasping.scenes import ClosedForm, ball


def judged(scene, hand, angles=None, on_table=False):
    """Verdicts on a hand in its rest frame, palm towards -y."""
    angles = torch.zeros(1, 21) if angles is None else angles
    pose = GraspPose(torch.eye(3)[None], hand.joints[:1], angles)
    none = torch.zeros(1, dtype=torch.int64)
    proposals = Proposals(pose, none, none, torch.tensor([on_table]), torch.zeros(1, 3))
    measures = measure(scene, hand, pose, proposals, AcceptanceConfig(), PostureConfig())
    passed = verdicts(measures, proposals.on_table, AcceptanceConfig())
    return measures, {name: bool(ok) for name, ok in passed.items()}


def test_hovering_hand_is_rejected_for_want_of_contact(hand):
    _, passed = judged(ball(0.03, (0, -0.2, 0)), hand)
    assert not passed["thumb"] and not passed["finger"]
    assert passed["max_depth"] and passed["through"]


def test_finger_through_a_thin_wall_is_rejected_though_no_vertex_is_deep(hand, anatomy):
    middle = hand.rest[anatomy.tips[2]] + torch.tensor([0.006, 0.0, 0.0])  # 6 mm before the tip of the middle finger
    plate = ClosedForm(lambda p: (p[..., 0] - middle[0]).abs() - 0.001)  # 2 mm thick, across the finger
    measures, passed = judged(plate, hand)
    assert passed["max_depth"] and measures.max_depth <= 1.001
    assert not passed["through"] and measures.through > 5


def test_finger_pressed_on_a_thin_wall_passes(hand, anatomy):
    front = hand.rest[anatomy.tips[2]][0] + 0.0006
    plate = ClosedForm(lambda p: (p[..., 0] - front + 0.001).abs() - 0.001)
    measures, passed = judged(plate, hand)
    assert passed["through"] and 0 < measures.through < 3


def test_measured_depth_is_that_of_the_formula(hand):
    centre = hand.rest[hand.anatomy.pads["palm_mcp"]].mean(0)
    scene = ball(0.01, tuple(centre.tolist()))
    measures, passed = judged(scene, hand)
    expected = (0.01 - (hand.rest - centre).norm(dim=1)).amax() * 1e3
    torch.testing.assert_close(measures.max_depth[0], expected)
    assert not passed["max_depth"]


def test_crossed_fingers_are_rejected(hand):
    angles = torch.zeros(1, 21)
    assert judged(ball(0.01, (1, 0, 0)), hand, angles)[1]["crossing"]
    angles[0, 1], angles[0, 5] = -0.3, 0.3
    assert not judged(ball(0.01, (1, 0, 0)), hand, angles)[1]["crossing"]


def test_hand_under_the_table_is_rejected_only_on_the_table(hand):
    scene = ball(0.01, (1, 0, 0))
    scene.floor = float(hand.rest[:, 2].min()) + 0.005
    assert not judged(scene, hand, on_table=True)[1]["table"]
    assert judged(scene, hand, on_table=False)[1]["table"]
