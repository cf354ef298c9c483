"""Labels, axes and limits of the hand, judged by what moves where when a joint turns."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from grabnet.body.anatomy import ANGLE_LIMITS, FINGERS, Anatomy, vertex_normals
from grabnet.body.hand import HandModel, HandParameters
from grabnet.body.skeleton import HAND_JOINTS
from grabnet.geometry.openings import boundary_loops
from grabnet.geometry.rotations import axis_angle_to_matrix

SIDES = ("right", "left")


@pytest.fixture(scope="module", params=SIDES)
def body(request):
    hand = HandModel.open(request.param)
    return hand, Anatomy.of(hand)


def posed(hand, anatomy, **angles):
    """Vertices with some angles set, others zero."""
    value = torch.zeros(1, 21)
    for name, angle in angles.items():
        value[0, anatomy.angle_names.index(name)] = angle
    return hand(HandParameters(torch.eye(3)[None], anatomy.hand_pose(value), torch.zeros(1, 3))).vertices[0]


# Known of the open hands' frame, on both sides.
PALMAR, RADIAL = torch.tensor([0.0, -1, 0]), torch.tensor([0.0, 0, 1])


def finger_of(name):
    return name.partition("_")[0]


def test_flexion_moves_the_fingertip_towards_the_palm(body):
    hand, anatomy = body
    middle_of_palm = hand.v_template[anatomy.pads["palm_mcp"]].mean(0)
    for name in anatomy.angle_names:
        if "abduction" in name or "twist" in name:
            continue
        tip = anatomy.tips[FINGERS.index(finger_of(name))]
        before, after = hand.v_template[tip], posed(hand, anatomy, **{name: 0.3})[tip]
        if finger_of(name) != "thumb":
            assert (after - before) @ PALMAR > 2e-3, name
        assert (after - middle_of_palm).norm() < (before - middle_of_palm).norm() - 1e-3, name


def test_abduction_leads_fingers_to_the_thumbs_side_and_the_thumb_out_of_the_palm(body):
    hand, anatomy = body
    for finger in FINGERS:
        joint = "cmc" if finger == "thumb" else "mcp"
        tip = anatomy.tips[FINGERS.index(finger)]
        move = posed(hand, anatomy, **{f"{finger}_{joint}_abduction": 0.2})[tip] - hand.v_template[tip]
        direction = PALMAR if finger == "thumb" else RADIAL
        assert move @ direction > (0.5 if finger == "thumb" else 0.9) * move.norm(), finger


def test_twist_keeps_the_thumb_where_it_points(body):
    hand, anatomy = body
    move = (posed(hand, anatomy, thumb_cmc_twist=0.4) - hand.v_template).norm(dim=-1)
    joint = hand.rest_joints(hand.v_template)[HAND_JOINTS.index("thumb2")]
    at_joint = (hand.v_template - joint).norm(dim=-1).argmin()
    assert move[at_joint] < 0.01


def test_an_angle_moves_its_own_finger_only(body):
    hand, anatomy = body
    for name in anatomy.angle_names:
        move = (posed(hand, anatomy, **{name: 0.3}) - hand.v_template).norm(dim=-1)
        finger = FINGERS.index(finger_of(name))
        others = [tip for f, tip in enumerate(anatomy.tips.tolist()) if f != finger]
        assert move[others].max() < 1e-6, name
        assert move[anatomy.tips[finger]] > 1e-3 or "twist" in name
        assert move[boundary_loops(hand.faces.numpy())[0]].max() < 1e-6, name


def test_the_thumb_can_touch_the_base_of_every_finger(body):
    hand, anatomy = body
    low, high = anatomy.angle_limits.T
    angles = torch.zeros(4000, 21)
    angles[:, 16:] = (low + (high - low) * torch.rand(4000, 21, generator=torch.Generator().manual_seed(0)))[:, 16:]
    eye = torch.eye(3).expand(4000, 3, 3)
    vertices = hand(HandParameters(eye, anatomy.hand_pose(angles), torch.zeros(4000, 3))).vertices
    for finger in FINGERS[1:]:
        base = hand.v_template[anatomy.pads[f"{finger}1"]].mean(0)
        assert (vertices[:, anatomy.tips[0]] - base).norm(dim=-1).min() < 0.008, finger


def test_axes_are_unit_vectors_and_thumb_axes_stand_upright_on_each_other(body):
    _, anatomy = body
    torch.testing.assert_close(anatomy.angle_axes.norm(dim=-1), torch.ones(21))
    thumb = anatomy.angle_axes[16:19]
    torch.testing.assert_close(thumb @ thumb.T, torch.eye(3), atol=1e-6, rtol=0)


def test_axes_mirror_as_axial_vectors():
    right, left = (Anatomy.of(HandModel.open(side)) for side in SIDES)
    torch.testing.assert_close(right.angle_axes * torch.tensor([1.0, -1, -1]), left.angle_axes, atol=1e-6, rtol=0)
    assert right.tips.tolist() == left.tips.tolist()
    assert all(torch.equal(right.pads[name], left.pads[name]) for name in right.pads)


def test_angles_become_the_rotations_scipy_makes(body):
    _, anatomy = body
    angles = torch.randn(5, 3, 21, generator=torch.Generator().manual_seed(2)) * 0.7
    pose = anatomy.hand_pose(angles)
    assert pose.shape == (5, 3, 15, 3, 3)
    axes = anatomy.angle_axes.double().numpy()

    def turn(*names):  # applied from the right: the last name first
        result = Rotation.identity()
        for name in names:
            k = anatomy.angle_names.index(name)
            result = result * Rotation.from_rotvec(angles[4, 2, k].item() * axes[k])
        return result.as_matrix()

    expected = {"thumb1": turn("thumb_cmc_abduction", "thumb_cmc_flexion", "thumb_cmc_twist"),
                "thumb2": turn("thumb_mcp"), "thumb3": turn("thumb_ip")}  # fmt: skip
    for finger in FINGERS[1:]:
        expected[f"{finger}1"] = turn(f"{finger}_mcp_abduction", f"{finger}_mcp_flexion")
        expected |= {f"{finger}2": turn(f"{finger}_pip"), f"{finger}3": turn(f"{finger}_dip")}
    for name, matrix in expected.items():
        np.testing.assert_allclose(pose[4, 2, HAND_JOINTS.index(name) - 1], matrix, atol=1e-6, err_msg=name)


def test_angle_joints_are_the_joints_that_turn(body):
    _, anatomy = body
    for k in range(21):
        angles = torch.zeros(21)
        angles[k] = 0.5
        turned = (anatomy.hand_pose(angles) - torch.eye(3)).abs().amax((-1, -2)) > 1e-6
        assert turned.nonzero().flatten().tolist() == [anatomy.angle_joints[k] - 1]


def test_limits_can_be_replaced_by_name(body):
    hand, anatomy = body
    assert anatomy.angle_limits.tolist() == torch.tensor(list(ANGLE_LIMITS.values())).tolist()
    other = Anatomy.of(hand, limits={"thumb_ip": (-0.1, 0.2)})
    assert other.angle_limits[-1].tolist() == torch.tensor([-0.1, 0.2]).tolist()
    assert torch.equal(other.angle_limits[:-1], anatomy.angle_limits[:-1])


def test_tips_are_the_far_ends_of_their_fingers(body):
    hand, anatomy = body
    for f in range(5):
        assert anatomy.finger[anatomy.tips[f]] == f
        own = anatomy.finger == f
        wrist = hand.rest_joints(hand.v_template)[0]
        reach = (hand.v_template - wrist).norm(dim=-1)
        assert reach[anatomy.tips[f]] > reach[own].max() - 0.004


def test_pads_face_inwards_and_lie_on_their_bones(body):
    hand, anatomy = body
    normals = vertex_normals(hand.v_template, hand.faces)
    for name, pad in anatomy.pads.items():
        assert len(pad) >= 5, name
        if name in HAND_JOINTS:
            assert (anatomy.bone[pad] == HAND_JOINTS.index(name)).all()
        if not name.startswith("thumb") and name != "index_side":
            assert (normals[pad] @ PALMAR > 0.3).all(), name
    palm = [set(anatomy.pads[f"palm_{part}"].tolist()) for part in ("thenar", "hypothenar", "mcp")]
    assert not palm[0] & palm[1] and not palm[0] & palm[2] and not palm[1] & palm[2]
    thenar, hypothenar = (hand.v_template[anatomy.pads[f"palm_{part}"]].mean(0) for part in ("thenar", "hypothenar"))
    assert thenar[2] > hypothenar[2] + 0.02


def test_normals_agree_with_trimesh_inside_a_batch(body):
    hand, _ = body
    vertices = torch.stack([hand.v_template, hand.shaped(torch.ones(10))])
    for one, ours in zip(vertices, vertex_normals(vertices, hand.faces), strict=True):
        mesh = trimesh.Trimesh(one, hand.faces, process=False)
        areas = mesh.area_faces[:, None] * mesh.face_normals
        expected = np.zeros((778, 3))
        np.add.at(expected, mesh.faces, areas[:, None])
        np.testing.assert_allclose(ours, expected / np.linalg.norm(expected, axis=1, keepdims=True), atol=1e-4)


def test_any_random_mano_hand_has_an_anatomy(tmp_path, random_mano):
    """Arrays of MANO's shapes, but the open hand's surface under a foreign rotation: nothing hangs on its frame."""
    open_hand = HandModel.open(dtype=torch.float64)
    turn = torch.as_tensor(Rotation.from_rotvec([0.4, -0.9, 0.3]).as_matrix())
    arrays = {name: getattr(open_hand, name).numpy() for name in ("shapedirs", "J_regressor", "weights")}
    arrays |= {"v_template": (open_hand.v_template @ turn.T).numpy(), "f": open_hand.faces.numpy()}
    np.savez(tmp_path / "MANO_RIGHT.npz", **random_mano | arrays)
    here, there = Anatomy.of(open_hand), Anatomy.of(HandModel(tmp_path / "MANO_RIGHT.npz", torch.float64))
    torch.testing.assert_close(here.angle_axes @ turn.T, there.angle_axes, atol=1e-5, rtol=0)
    assert here.tips.tolist() == there.tips.tolist()
    assert all(torch.equal(here.pads[name], there.pads[name]) for name in here.pads)


@pytest.mark.parametrize("side", ["right", "left"])
def test_angles_are_found_again(side):
    anatomy = Anatomy.of(HandModel.open(side, torch.float64))
    low, high = anatomy.angle_limits.T
    drawn = low + (high - low) * torch.rand(200, 21, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    angles, left = anatomy.angles(anatomy.hand_pose(drawn))
    torch.testing.assert_close(angles, drawn, atol=1e-6, rtol=0)
    assert left.max() < 1e-6


def test_turns_that_a_joint_does_not_have_are_told(hand):
    """A fingertip bent sideways by .2 rad after flexion of .5, and a knuckle twisted by .1."""
    anatomy = Anatomy.of(hand)
    flexion, abduction = anatomy.angle_axes[0], anatomy.angle_axes[1]

    def about(axis, angle):
        return axis_angle_to_matrix(axis * angle)

    pose = torch.eye(3).repeat(1, 15, 1, 1)
    pose[0, 2] = about(abduction, 0.2) @ about(flexion, 0.5)
    pose[0, 3] = about(torch.linalg.cross(anatomy.angle_axes[4], anatomy.angle_axes[5]), 0.1)
    angles, left = anatomy.angles(pose)
    assert left[0, 2] == pytest.approx(0.2, abs=1e-3)
    assert left[0, 3] == pytest.approx(0.1, abs=1e-3)
    assert angles[0, anatomy.angle_names.index("index_dip")] == pytest.approx(0.5, abs=1e-3)
    assert left.gt(1e-3).sum() == 2
