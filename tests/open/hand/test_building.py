"""The steps that make the open hand."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import OPEN_HANDS, HandModel
from grabnet.body.skeleton import HAND_JOINTS
from grabnet.errors import UserError
from grabnet.geometry.openings import boundary_loops
from grabnet.io.npz import read_npz
from grabnet.open.hand.build import mirrored
from grabnet.open.hand.decimate import decimate
from grabnet.open.hand.flatten import FlatHands, flatten
from grabnet.open.hand.knuckles import KNUCKLES, finger_shares, move_knuckles
from grabnet.open.hand.poses import grasp_poses, principal_poses
from grabnet.open.hand.shapes import calibrate, joint_regressor, principal_shapes, vary
from grabnet.open.hand.source import BONES, AdultHands, sample_adults


@pytest.fixture(scope="module")
def anatomy(hand):
    return Anatomy.of(hand)


@pytest.fixture(scope="module")
def flat_hands(hand):
    """Thirty of the open hand's own shapes, as the build sees them: wrist at the origin."""
    rest = hand.shaped(torch.randn(30, 10, generator=torch.Generator().manual_seed(0)))
    joints = hand.rest_joints(rest)
    return FlatHands(
        (rest - joints[:, :1]).double().numpy(),
        hand.faces.numpy(),
        (joints - joints[:, :1]).double().numpy(),
        hand.weights.double().numpy(),
    )


# --- The shipped files ------------------------------------------------------------------------------------------------


def open_sphere():
    mesh = trimesh.creation.icosphere(3, 1.0)
    faces = mesh.faces[mesh.triangles_center[:, 2] < 0.7]
    kept = np.unique(faces)
    return mesh.vertices[kept], np.searchsorted(kept, faces)


@pytest.mark.parametrize(("n", "rim"), [(300, 20), (120, 12)])
def test_decimation_keeps_places_counts_and_surface(n, rim):
    vertices, faces = open_sphere()
    kept, smaller = decimate(vertices, faces, n, rim, np.zeros((len(vertices), 1)))
    assert len(kept) == n and np.unique(kept).size == n
    mesh = trimesh.Trimesh(vertices[kept], smaller, process=False)
    assert mesh.is_winding_consistent
    assert mesh.euler_number == 1  # a disc
    (loop,), (finer,) = boundary_loops(smaller), boundary_loops(faces)
    assert rim <= len(loop) < len(finer)
    assert (mesh.face_normals * mesh.triangles_center).sum(1).min() > 0.7  # nothing flipped
    assert np.linalg.norm(mesh.triangles_center, axis=1).min() > (0.97 if n == 300 else 0.92)


def test_decimation_spares_vertices_where_weights_change():
    vertices, faces = open_sphere()
    belt = np.abs(vertices[:, 0]) < 0.3
    weights = np.clip(vertices[:, :1] / 0.6 + 0.5, 0, 1)
    plain, spared = (decimate(vertices, faces, 200, 16, w)[0] for w in (np.zeros_like(weights), 10 * weights))
    assert belt[spared].sum() > belt[plain].sum() * 1.3


def curled_hands(n=3):
    """Stick hands in the body frame: random bone lengths, curled fingers, one point of skin beside each bone's head."""
    rng = np.random.default_rng(0)
    heads, tails = np.zeros((n, len(BONES), 3)), np.zeros((n, len(BONES), 3))

    def place(bone, start, step):
        heads[:, BONES.index(bone)] = start
        tails[:, BONES.index(bone)] = np.add(start, step)

    place("lowerarm01", [0, 0, 0.25], [0, 0, -0.13])
    place("lowerarm02", [0, 0, 0.12], [0, 0, -0.12])
    place("wrist", [0, 0, 0], [0, 0, -0.05])
    for finger in range(1, 6):
        # A right arm hanging down, palm towards the thigh (+x), thumb forwards (−y): MakeHuman faces −y.
        root = np.array([0.0, -0.03 + 0.015 * (finger - 2), -0.09]) if finger > 1 else np.array([0.01, -0.03, -0.03])
        angle = 0.0
        for k in (1, 2, 3):
            angle += rng.uniform(0.1, 0.3)
            step = rng.uniform(0.02, 0.04, (n, 1)) * np.array([np.sin(angle), 0, -np.cos(angle)])
            place(f"finger{finger}-{k}", root, step)
            root = root + step
    for finger in (1, 2, 3, 4):
        place(f"metacarpal{finger}", heads[:, BONES.index("wrist")], [0, 0, -0.05])
    skin = heads + rng.normal(0, 0.005, (n, len(BONES), 3))
    return AdultHands(skin, np.zeros((0, 3), int), heads, tails, np.eye(len(BONES)))


def test_flattening_straightens_fingers_and_keeps_lengths():
    hands = curled_hands()
    flat = flatten(hands)
    np.testing.assert_allclose(flat.joints[:, 0], 0, atol=1e-12)
    np.testing.assert_allclose(flat.joints[:, HAND_JOINTS.index("middle1"), 1:], 0, atol=1e-9)
    assert (flat.joints[:, HAND_JOINTS.index("middle1"), 0] < 0).all()
    assert (flat.joints[:, HAND_JOINTS.index("index1"), 2] > flat.joints[:, HAND_JOINTS.index("pinky1"), 2]).all()
    for number, finger in ((2, "index"), (3, "middle"), (4, "ring"), (5, "pinky")):
        bones = [BONES.index(f"finger{number}-{k}") for k in (1, 2, 3)]
        joints = flat.joints[:, HAND_JOINTS.index(f"{finger}1") :][:, :3]
        before, after = (np.diff(x, axis=1) for x in (hands.heads[:, bones], joints))
        np.testing.assert_allclose(np.linalg.norm(after, axis=-1), np.linalg.norm(before, axis=-1), atol=1e-9)
        np.testing.assert_allclose(np.cross(after[:, 0], after[:, 1]), 0, atol=1e-9)
        np.testing.assert_allclose(after[..., 1], 0, atol=1e-9)
        for k, bone in enumerate(bones):  # skin moves rigidly with its bone
            distance = np.linalg.norm(hands.vertices[:, bone] - hands.heads[:, bone], axis=-1)
            np.testing.assert_allclose(np.linalg.norm(flat.vertices[:, bone] - joints[:, k], axis=-1), distance)
    np.testing.assert_allclose(flat.weights.sum(1), 1)


def test_flattening_does_not_depend_on_where_the_hand_is():
    hands = curled_hands()
    turn, shift = Rotation.from_rotvec([0.5, -1.0, 2.0]).as_matrix(), np.array([1.0, -2.0, 0.5])
    moved = AdultHands(
        hands.vertices @ turn.T + shift, hands.faces, hands.heads @ turn.T + shift, hands.tails @ turn.T + shift,
        hands.weights,
    )  # fmt: skip
    np.testing.assert_allclose(flatten(moved).vertices, flatten(hands).vertices, atol=1e-9)
    np.testing.assert_allclose(flatten(moved).joints, flatten(hands).joints, atol=1e-9)


def test_finger_shares_are_whole_on_the_shafts_and_mixed_in_the_webs(flat_hands):
    share = finger_shares(flat_hands.vertices[0], flat_hands.faces, flat_hands.weights)
    np.testing.assert_allclose(share.sum(1), 1, atol=1e-9)
    assert share.min() > -1e-12  # the maximum principle
    for f, knuckle in enumerate(KNUCKLES):
        shaft = flat_hands.weights[:, knuckle : knuckle + 3].sum(1) > 0.9
        assert (share[shaft, f] == 1).all()
    assert (share.max(1) < 0.7).any()


def test_moving_knuckles(flat_hands):
    moved = move_knuckles(flat_hands, proximal=0.004, dorsal=0.001)
    shift = moved.joints - flat_hands.joints
    np.testing.assert_allclose(shift[:, KNUCKLES], np.broadcast_to([0.004, 0.001, 0], (30, 4, 3)), atol=1e-12)
    assert not np.delete(shift, KNUCKLES, axis=1).any()
    np.testing.assert_allclose(moved.weights.sum(1), 1, atol=1e-12)
    assert moved.weights.min() >= 0
    np.testing.assert_allclose(moved.weights[:, 13:], flat_hands.weights[:, 13:], atol=1e-4)
    # Along the middle finger's ray the skin passes from palm to finger about the new knuckle.
    knuckle = moved.joints.mean(0)[KNUCKLES[1]]
    beyond, _, across = (flat_hands.vertices.mean(0) - knuckle).T * [[-1], [1], [1]]
    share = finger_shares(flat_hands.vertices.mean(0), flat_hands.faces, flat_hands.weights)[:, 1]
    follows = moved.weights[:, 4:7].sum(1)
    assert follows[(share > 0.99) & (beyond > 0.015)].min() > 0.98
    assert follows[beyond < -0.018].max() < 0.01
    ray = (np.abs(across) < 0.008) & (np.abs(beyond) < 0.02)
    assert np.corrcoef(beyond[ray], follows[ray])[0, 1] > 0.85


def test_variation_of_nothing_is_nothing(flat_hands):
    same = vary(flat_hands, seed=0, length=0, girth=0, breadth=0)
    np.testing.assert_array_equal(same.vertices, flat_hands.vertices)
    np.testing.assert_array_equal(same.joints, flat_hands.joints)


def test_variation_changes_fingers_by_the_share_asked_for(flat_hands):
    many = FlatHands(
        np.repeat(flat_hands.vertices[:1], 400, 0), flat_hands.faces, np.repeat(flat_hands.joints[:1], 400, 0),
        flat_hands.weights,
    )  # fmt: skip
    varied = vary(many, seed=0, length=0.05, girth=0, breadth=0)
    for first in KNUCKLES:
        bones = np.linalg.norm(varied.joints[:, first + 1] - varied.joints[:, first], axis=-1)
        assert bones.std() / bones.mean() == pytest.approx(0.05, rel=0.12)
        assert bones.mean() == pytest.approx(
            np.linalg.norm(many.joints[0, first + 1] - many.joints[0, first]), rel=0.01
        )
    np.testing.assert_array_equal(varied.joints[:, KNUCKLES], many.joints[:, KNUCKLES])
    np.testing.assert_array_equal(vary(many, seed=0, length=0.05, girth=0, breadth=0).vertices, varied.vertices)


def test_calibration_gives_the_lengths_asked_for(flat_hands):
    hands = calibrate(flat_hands, mean=0.2, deviation=0.004)
    length = -hands.vertices[..., 0].min(1)
    assert length.mean() == pytest.approx(0.2)
    assert length.std() == pytest.approx(0.004)
    ratio = hands.joints[:, 1:] / flat_hands.joints[:, 1:]
    np.testing.assert_allclose(ratio, np.broadcast_to(ratio[:, :1, :1], ratio.shape), rtol=1e-9)  # shape kept


def test_principal_shapes_find_the_directions_that_made_the_data():
    rng = np.random.default_rng(0)
    true = np.linalg.qr(rng.normal(size=(60, 3)))[0] * (5, 2, 1)
    shapes = (rng.normal(size=(5000, 3)) @ true.T).reshape(5000, 20, 3) + 7
    mean, directions, explained = principal_shapes(shapes, 3)
    np.testing.assert_allclose(mean, 7, atol=0.2)
    found = directions.reshape(60, 3)
    cosine = np.abs((found * true).sum(0)) / np.linalg.norm(found, axis=0) / np.linalg.norm(true, axis=0)
    assert (cosine > 0.99).all()
    np.testing.assert_allclose(np.linalg.norm(found, axis=0), [5, 2, 1], rtol=0.05)
    np.testing.assert_allclose(explained, np.array([25, 4, 1]) / 30, atol=0.02)


def test_regressor_recovers_joints_inside_the_hand(flat_hands):
    rows = joint_regressor(
        flat_hands.vertices[:20], flat_hands.joints[:20], flat_hands.weights, [-1, *HandModel.open().parents[1:]]
    )
    assert rows.min() >= 0
    np.testing.assert_allclose(rows.sum(1), 1)
    error = np.linalg.norm(rows @ flat_hands.vertices[20:] - flat_hands.joints[20:], axis=-1)
    assert error.mean() < 5e-4 and error.max() < 2e-3


def test_mirroring_twice_is_nothing():
    model = read_npz(OPEN_HANDS / "MANO_RIGHT.npz")
    for name, array in mirrored(mirrored(model)).items():
        np.testing.assert_array_equal(array, model[name], err_msg=name)


def test_grasp_poses_keep_to_the_limits_and_their_components_are_orthonormal(anatomy):
    poses = grasp_poses(anatomy, 500, seed=0)
    np.testing.assert_array_equal(poses, grasp_poses(anatomy, 500, seed=0))
    index_pip = anatomy.angle_names.index("index_pip")
    joint = anatomy.angle_joints[index_pip] - 1
    angle = poses.reshape(500, 15, 3)[:, joint] @ anatomy.angle_axes[index_pip].numpy()
    low, high = anatomy.angle_limits[index_pip].tolist()
    assert angle.min() >= low - 1e-6 and angle.max() <= high + 1e-6
    components = principal_poses(poses)
    np.testing.assert_allclose(components @ components.T, np.eye(45), atol=1e-6)
    spread = (poses @ components.T).var(0)
    assert (np.diff(spread[:20]) <= 1e-9).all()


def test_without_anny_one_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "anny", None)
    with pytest.raises(UserError, match="open-hand"):
        sample_adults(1, 0)
