from __future__ import annotations

import pytest
import torch

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.grasping.grasp_hand import GraspHand, GraspPose

from .conftest import poses


@pytest.fixture(scope="module", params=["right", "left"])
def either(request) -> GraspHand:
    model = HandModel.open(request.param, dtype=torch.float64)
    return GraspHand(model, Anatomy.of(model), torch.linspace(-1, 1, 10, dtype=torch.float64))


def test_samples_and_their_gradient_are_those_of_the_posed_hand(either):
    leaves = [[x.clone().requires_grad_() for x in poses(5, dtype=torch.float64)] for _ in range(2)]
    points, sampled = either.sampled(GraspPose(*leaves[0]))
    posed = either.posed(GraspPose(*leaves[1]), either.sample)
    normals = either.posed_normals(posed.rotations, either.sample[either.pads].flatten())
    expected = torch.cat([posed.vertices, posed.spheres, posed.forearm], 1)
    torch.testing.assert_close(points, expected)
    torch.testing.assert_close(torch.cat(sampled[:3], 1), expected)
    torch.testing.assert_close(sampled.facing.flatten(1, 2), normals)

    generator = torch.Generator().manual_seed(1)
    pull, turn = (torch.randn(x.shape, generator=generator, dtype=torch.float64) for x in (points, normals))
    ((points * pull).sum() + (sampled.facing.flatten(1, 2) * turn).sum()).backward()
    ((expected * pull).sum() + (normals * turn).sum()).backward()
    for ours, autograd in zip(*leaves, strict=True):
        torch.testing.assert_close(ours.grad, autograd.grad)
