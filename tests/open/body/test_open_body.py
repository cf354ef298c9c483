"""The shipped open body and its subjects."""

from __future__ import annotations

import contextlib
import io

import numpy as np
import pytest
import smplx
import torch
import trimesh

from grabnet.body.hand import HandModel, HandParameters
from grabnet.body.skeleton import JOINTS, MIRROR_JOINT, PARENTS, RIGHT_HAND_JOINTS
from grabnet.body.whole import OPEN_BODY, BodyModel, BodyParameters
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.io.files import sha256
from grabnet.io.npz import read_npz
from grabnet.open.body.gluing import Gluing
from grabnet.open.body.subjects import open_subjects
from grabnet.open.grasps.store import load_open_grasps

FILES = ("SMPLX_NEUTRAL.npz", "subjects.npz")


@pytest.fixture(scope="module")
def body():
    return BodyModel.open()


@pytest.fixture(scope="module")
def subjects(body):
    return open_subjects(body, load_open_grasps())


@pytest.fixture(scope="module")
def stored():
    return read_npz(OPEN_BODY / "subjects.npz")


def test_files_are_small_and_the_readme_names_their_hashes():
    assert sum((OPEN_BODY / name).stat().st_size for name in FILES) < 2_700_000
    text = (OPEN_BODY / "README.md").read_text(encoding="utf-8")
    assert all(sha256(OPEN_BODY / name) in text for name in FILES)


def test_surface_is_closed_and_sound(body):
    mesh = trimesh.Trimesh(body.v_template.numpy(), body.faces.numpy(), process=False)
    assert mesh.is_watertight and mesh.volume > 0.04
    for rows in (body.weights, body.J_regressor):
        assert (rows >= 0).all()
        torch.testing.assert_close(rows.sum(1), torch.ones(len(rows)), atol=1e-4, rtol=0)
    assert body.parents == list(PARENTS)


def test_left_mirrors_right(body, subjects):
    for vertices in (body.v_template, torch.as_tensor(subjects[3].v_template)):
        joints = body.rest_joints(vertices)
        mirrored = joints[list(MIRROR_JOINT)] * torch.tensor([-1.0, 1, 1])
        torch.testing.assert_close(joints, mirrored, atol=1e-3, rtol=0)
        images = vertices * torch.tensor([-1.0, 1, 1])
        assert torch.cdist(images[::7], vertices).amin(1).max() < 1e-3


def test_joints_lie_inside(body):
    query = MeshQuery(Mesh(body.v_template.numpy(), body.faces.numpy()))
    distance = query.signed_distance(body.rest_joints(body.v_template))
    assert (distance < 0.002).float().mean() > 0.95


def test_rest_pose_is_smplx_s(body):
    joints = dict(zip(JOINTS, body.rest_joints(body.v_template), strict=True))
    arm = joints["left_wrist"] - joints["left_shoulder"]
    assert arm[0] / arm.norm() > 0.99
    assert joints["head"][1] > joints["pelvis"][1] > joints["left_knee"][1] > joints["left_foot"][1]
    assert joints["left_foot"][2] > joints["left_ankle"][2] + 0.05


def test_nothing_tears_when_it_bends(body, subjects):
    """Elbows, knees, hips, shoulders and wrists well bent: no edge becomes a spike."""
    generator = torch.Generator().manual_seed(0)
    poses = torch.zeros(8, 55, 3)
    poses[:, 1:22] = 0.35 * torch.randn(8, 21, 3, generator=generator)
    poses[0, 17], poses[1, 19], poses[2, 5] = torch.tensor([[0, 0, 1.3], [0, 2.2, 0], [1.8, 0, 0]])
    faces = body.faces
    edges = torch.unique(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).sort(1)[0], dim=0).T
    rest = torch.as_tensor(subjects[0].v_template)
    posed = body(BodyParameters.from_rotations(axis_angle_to_matrix(poses), torch.zeros(8, 3)), rest).vertices
    longer = [(v[..., edges[0], :] - v[..., edges[1], :]).norm(dim=-1) for v in (posed, rest)]
    assert (longer[0] - longer[1]).max() < 0.06


def test_loads_in_smplx_and_agrees(body):
    with contextlib.redirect_stdout(io.StringIO()):
        theirs = smplx.create(
            str(OPEN_BODY / "SMPLX_NEUTRAL.npz"), "smplx", ext="npz", use_pca=False, flat_hand_mean=True
        )
    betas, pose = torch.randn(1, 10), 0.3 * torch.randn(1, 21, 3)
    rotations = torch.eye(3).expand(1, 55, 3, 3).clone()
    rotations[:, 1:22] = axis_angle_to_matrix(pose)
    ours = body(BodyParameters.from_rotations(rotations, torch.zeros(1, 3)), body.shaped(betas))
    expected = theirs(betas=betas, body_pose=pose.flatten(1)).vertices
    torch.testing.assert_close(ours.vertices, expected, atol=1e-5, rtol=0)


def test_ten_people(subjects):
    assert [s.name for s in subjects] == [f"s{k}" for k in range(1, 11)]
    assert [s.gender for s in subjects] == ["female"] * 5 + ["male"] * 5
    heights = np.array([np.ptp(s.v_template[:, 1]) for s in subjects])
    assert (heights > 1.45).all() and (heights < 2.0).all()
    assert heights[5:].mean() > heights[:5].mean() + 0.05


def test_hands_are_those_of_the_grasps(body, subjects, stored, hand):
    """At rest exactly; with bent fingers too; with a bent wrist but for the skin about it."""
    grasps = load_open_grasps()
    in_hand = torch.as_tensor(stored["rhand_vertices"].astype(int))
    for subject, betas in zip(subjects, grasps.betas, strict=True):
        rest = torch.as_tensor(subject.v_template)
        own = hand.shaped(betas)
        np.testing.assert_allclose(subject.rhand, own, atol=1e-6)
        wrist = body.rest_joints(rest)[21] - hand.rest_joints(own)[0]
        torch.testing.assert_close(rest[in_hand], own + wrist, atol=1e-5, rtol=0)
        torch.testing.assert_close(
            body.rest_joints(rest)[list(RIGHT_HAND_JOINTS)], hand.rest_joints(own) + wrist, atol=1e-5, rtol=0
        )
    fingers = axis_angle_to_matrix(hand.hands_mean.view(1, 15, 3))
    rotations = torch.eye(3).expand(1, 55, 3, 3).clone()
    rotations[:, 40:] = fingers
    for bend, share, most in ((0.0, 1.0, 1e-4), (0.6, 0.75, 0.02)):
        rotations[:, 21] = axis_angle_to_matrix(torch.tensor([[0.0, 0, bend]]))
        posed = body(BodyParameters.from_rotations(rotations, torch.zeros(1, 3)), rest)
        alone = HandParameters(rotations[:, 21], fingers, posed.joints[:, 21] - hand.rest_joints(own)[0])
        apart = (hand(alone, own).vertices - posed.vertices[:, in_hand]).norm(dim=-1)
        assert apart.max() < most
        assert (apart < 1e-4).float().mean() >= share


def test_left_hand_is_the_mirror_image(body, subjects, stored):
    rest = torch.as_tensor(subjects[7].v_template)
    left, right = (rest[torch.as_tensor(stored[f"{s}hand_vertices"].astype(int))] for s in "lr")
    joints = body.rest_joints(rest)
    torch.testing.assert_close(left - joints[20], (right - joints[21]) * torch.tensor([-1.0, 1, 1]), atol=1e-5, rtol=0)
    assert HandModel.open("left").v_template.shape == left.shape


def test_gluing_follows_the_hand_smoothly():
    """A tube along x whose end is moved: the middle follows in between, the far end stays."""
    tube = trimesh.creation.cylinder(0.03, 0.4, sections=24).subdivide().subdivide().subdivide()
    vertices = tube.vertices[:, [2, 0, 1]] - [0.25, 0, 0]
    hand = (vertices[:, 0] < -0.4).nonzero()[0]
    glue = Gluing(vertices, tube.faces, hand, reach=0.1)
    moved = glue(vertices, vertices[hand] + [0, 0.01, 0]) - vertices
    np.testing.assert_allclose(moved[hand], np.tile([0, 0.01, 0], (len(hand), 1)), atol=1e-12)
    far = vertices[:, 0] > -0.29
    assert np.abs(moved[far]).max() == 0
    assert (moved[:, 1] > -1e-4).all() and (moved[:, 1] < 0.0101).all()
