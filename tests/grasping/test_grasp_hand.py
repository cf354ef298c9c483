from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from grabnet.body.anatomy import FINGERS
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.openings import close
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.grasping.grasp_hand import GraspHand, GraspPose

from .conftest import poses


def test_skin_is_that_of_the_hand_model(model, anatomy):
    betas = torch.linspace(-1.5, 1.5, 10)
    hand, pose = GraspHand(model, anatomy, betas), poses(6)
    expected = model(hand.parameters(pose), model.shaped(betas))
    torch.testing.assert_close(hand.posed(pose).vertices, expected.vertices)
    torch.testing.assert_close(pose.wrist, expected.joints[:, 0])


def test_spheres_lie_inside_the_hand(model, anatomy, hand):
    rest = GraspPose(torch.eye(3)[None], hand.joints[:1], torch.zeros(1, 21))
    query = MeshQuery(Mesh(*close(hand.rest.numpy(), model.faces.numpy())))
    depth = -query.signed_distance(hand.posed(rest).spheres[0])
    assert (depth > 0).all()
    assert (hand.radii < depth + 0.0085).all()  # and hardly reach out of it, where a finger is flatter than wide
    assert set(((hand.sphere_bone[hand.sphere_bone > 0] - 1) // 3).tolist()) == set(range(len(FINGERS)))


def test_spheres_move_rigidly_with_their_bones(hand):
    pose = poses(2)
    posed = hand.posed(pose)
    for bone in hand.sphere_bone.unique():
        here = posed.spheres[:, hand.sphere_bone == bone]
        apart = torch.cdist(here, here)
        torch.testing.assert_close(apart[0], apart[1], atol=1e-6, rtol=1e-4)


def test_pads_name_vertices_of_the_anatomys_pads(anatomy, hand):
    assert len(hand.sample[hand.sampled_once].unique()) >= 0.9 * int(hand.sampled_once.sum())
    for name, members, mask in zip(hand.pad_names, hand.pads, hand.pad_mask, strict=True):
        chosen = hand.sample[members[mask]]
        assert torch.isin(chosen, anatomy.pads[name]).all()
        assert len(chosen.unique()) == len(chosen) > 0


def test_pads_without_vertices_are_left_out_and_a_hand_without_a_thumb_is_refused(model, anatomy):
    nothing = torch.zeros(0, dtype=torch.int64)
    fewer = replace(anatomy, pads=anatomy.pads | {"index_side": nothing, "palm_mcp": nothing})
    assert "index_side" not in GraspHand(model, fewer, torch.zeros(10)).pad_names
    with pytest.raises(UserError, match="no pads at the tips"):
        GraspHand(model, replace(anatomy, pads=anatomy.pads | {"thumb3": nothing}), torch.zeros(10))


def test_parameters_and_back_is_the_same_pose(hand, left):
    pose = poses(8)
    for either in (hand, left):
        pose = pose._replace(angles=pose.angles.clamp(*either.anatomy.angle_limits.T))
        for ours, expected in zip(either.pose_of(either.parameters(pose)), pose, strict=True):
            torch.testing.assert_close(ours, expected, atol=1e-5, rtol=0)


def test_what_no_hand_can_do_is_left_out_of_a_pose(hand):
    beyond = poses(4)
    beyond.angles[:, 2] = 2.5  # of 1.8
    parameters = hand.parameters(beyond)
    sideways = axis_angle_to_matrix(0.4 * hand.anatomy.frame[1].expand(4, 3))
    parameters.hand_pose[:, 2] = parameters.hand_pose[:, 2] @ sideways  # a fingertip
    angles = hand.pose_of(parameters).angles
    assert (angles[:, 2] - 2.5).abs().max() < 1e-3  # beyond its limit, as it is
    _, left_over = hand.anatomy.angles(hand.parameters(hand.pose_of(parameters)).hand_pose)
    assert left_over.abs().max() < 1e-3
