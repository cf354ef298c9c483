"""Inverse kinematics of the arm against forward kinematics of the body."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from grabnet.body.skeleton import JOINTS
from grabnet.body.whole import BodyParameters
from grabnet.open.sequences.arms import LONGEST_REACH, effort
from grabnet.open.sequences.motion import Pose

N = 200


@pytest.fixture(scope="module", params=["right", "left"])
def reached(request, actor):
    """Random trunks and wrists within reach, and the arms that reach them."""
    side, rng = request.param, np.random.default_rng(0)
    trunk = rng.normal(0, 0.2, (N, 5))
    shoulder = actor.shoulder(actor.trunk(trunk), side)
    way = rng.normal(size=(N, 3)) + np.array([0, -0.3, 1.2])
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    far = rng.uniform(0.45, 0.97, (N, 1)) * sum(actor.arms[side].length)
    wrist = Pose(Rotation.random(N, random_state=1).as_matrix(), shoulder + far * way)
    swivel = rng.uniform(-30, 60, N)
    return side, trunk, wrist, swivel, actor.reach(side, actor.trunk(trunk), wrist, swivel)


def posed(actor, side, trunk, pose):
    """Joints by the body model itself, in the frame of the plan."""
    values = actor.trunk(trunk)
    rotations = torch.eye(3).expand(N, 55, 3, 3).clone()
    parts = dict(values.rotations) | {
        f"{side}_{name}": r
        for name, r in zip(("shoulder", "elbow", "wrist"), pose.rotations.swapaxes(0, 1), strict=True)
    }
    for joint, turned in parts.items():
        rotations[:, JOINTS.index(joint)] = torch.as_tensor(turned, dtype=torch.float32)
    transl = torch.as_tensor(values.transl, dtype=torch.float32)
    return rotations, actor.body(BodyParameters.from_rotations(rotations, transl), actor.v_template).joints.numpy()


def world_rotation(actor, rotations, joint):
    turned, j = torch.eye(3), JOINTS.index(joint)
    while j >= 0:
        turned, j = rotations[:, j] @ turned, actor.body.parents[j]
    return turned.numpy()


def test_the_wrist_arrives(actor, reached):
    side, trunk, wrist, _, pose = reached
    rotations, joints = posed(actor, side, trunk, pose)
    np.testing.assert_allclose(joints[:, JOINTS.index(f"{side}_wrist")], wrist.position, atol=2e-5)
    np.testing.assert_allclose(world_rotation(actor, rotations, f"{side}_wrist"), wrist.rotation, atol=2e-5)
    np.testing.assert_allclose(joints[:, JOINTS.index(f"{side}_elbow")], pose.elbow_at, atol=2e-5)


def test_elbows_bend_forwards_only(actor, reached):
    """The elbow's own rotation, twist along the forearm taken off, is about the hinge, one way."""
    side, *_, pose = reached
    arm = actor.arms[side]
    fore = arm.fore / np.linalg.norm(arm.fore)
    bent = pose.elbow @ fore
    hinge = np.cross(fore, bent) @ [0, -arm.outward, 0]
    assert (hinge > 0).all(), "towards the front of the body in T-pose"
    assert np.abs((bent - fore) @ [0, 1, 0]).max() < 0.05, "about the hinge"


def test_the_feet_stay(actor, reached):
    side, trunk, _, _, pose = reached
    _, joints = posed(actor, side, trunk, pose)
    feet = [JOINTS.index(f"{s}_{part}") for s in ("left", "right") for part in ("hip", "ankle", "foot")]
    np.testing.assert_allclose(joints[:, feet], np.broadcast_to(actor.joints[feet], (N, 6, 3)), atol=5e-4)


def test_swivel_turns_the_elbow_outwards(actor, reached):
    side, trunk, wrist, swivel, pose = reached
    further = actor.reach(side, actor.trunk(trunk), wrist, swivel + 20)
    moved = (further.elbow_at - pose.elbow_at)[:, 0] * actor.arms[side].outward
    hanging = swivel < 40
    assert (moved[hanging] > 0).mean() > 0.75, "but for arms that point up or back"
    np.testing.assert_allclose(further.reach, pose.reach)


def test_too_far_is_told(actor):
    trunk = np.zeros((1, 5))
    shoulder = actor.shoulder(actor.trunk(trunk), "right")
    wrist = Pose(np.eye(3)[None], shoulder + np.array([0, 0, 1.2 * sum(actor.arms["right"].length)]))
    pose = actor.reach("right", actor.trunk(trunk), wrist, np.zeros(1))
    assert pose.reach[0] == pytest.approx(1.2) and pose.reach[0] > LONGEST_REACH
    assert np.isinf(effort(pose, np.zeros(1)))[0]


def test_supination_is_counted_from_thumb_up(actor):
    """With the forearm before the body: palm down is a quarter turn of pronation, on either side."""
    trunk = np.zeros((1, 5))
    for side in ("right", "left"):
        arm = actor.arms[side]
        shoulder = actor.shoulder(actor.trunk(trunk), side)
        # Forearm straight ahead, then the hand turned about it from palm down to thumb up.
        ahead = Rotation.from_rotvec([0, -arm.outward * np.pi / 2, 0])
        for degrees in (0, 90):
            thumb_up = Rotation.from_rotvec([0, 0, -arm.outward * np.radians(degrees)])
            wrist = Pose((thumb_up * ahead).as_matrix()[None], shoulder + np.array([0, -0.25, 0.24]))
            pose = actor.reach(side, actor.trunk(trunk), wrist, np.array([0.0]))
            assert pose.supination[0] == pytest.approx(degrees - 90, abs=40)
