from __future__ import annotations

import torch

from grabnet.body.hand import HandModel
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.openings import close
from grabnet.geometry.queries import MeshQuery
from grabnet.grasping.grasp_hand import GraspHand
from grabnet.grasping.interior import Interior

from .test_grasp_hand import poses


def test_points_are_where_the_bones_carry_them(hand):
    posed = hand.posed(poses(20))
    found = Interior.of(hand).points(posed.vertices)
    torch.testing.assert_close(found, posed.spheres, atol=1e-5, rtol=0)
    mirror = torch.tensor([-1.0, 1, 1])
    torch.testing.assert_close(
        Interior.of(hand).points(posed.vertices * mirror), posed.spheres * mirror, atol=1e-5, rtol=0
    )


def test_in_hands_of_other_shapes_they_lie_inside(model: HandModel, anatomy, hand):
    interior = Interior.of(hand)
    for seed in range(3):
        betas = torch.randn(10, generator=torch.Generator().manual_seed(seed))
        posed = GraspHand(model, anatomy, betas).posed(poses(1, seed))
        query = MeshQuery(Mesh(*close(posed.vertices[0].numpy(), model.faces.numpy())))
        assert query.signed_distance(interior.points(posed.vertices)[0]).max() < 0.0005


def test_the_chain_joins_all_points_along_the_fingers(hand):
    chain = Interior.of(hand).chain
    n = len(hand.sphere_bone)
    assert chain.shape == (n - 1, 2) and chain.unique().tolist() == list(range(n))
    start, end = hand.sphere_bone[chain].T
    finger = torch.where(hand.sphere_bone > 0, (hand.sphere_bone - 1) // 3, -1)
    between = finger[chain[:, 0]] != finger[chain[:, 1]]
    assert between.sum() == 5  # each finger hangs on the palm once, and on no other finger
    assert (torch.minimum(start, end)[between] == 0).all()
