"""Blend skinning against the textbook's four-by-four matrices, vertex by vertex."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from grabnet.body.skinning import forward_kinematics, homogeneous, skin, tree_levels
from grabnet.geometry.rotations import random_rotations

HAND = [-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14]

trees = st.lists(st.integers(0, 10**6), max_size=11).map(
    lambda picks: [-1] + [p % (k + 1) for k, p in enumerate(picks)]
)


def textbook_transforms(rotations, joints, parents):
    """(J, 4, 4) world transforms of one pose: each joint turns in its parent's frame, offset from it as at rest."""
    world = []
    for j, parent in enumerate(parents):
        local = torch.eye(4, dtype=rotations.dtype)
        local[:3, :3] = rotations[j]
        local[:3, 3] = joints[j] - (joints[parent] if parent >= 0 else 0)
        world.append(local if parent < 0 else world[parent] @ local)
    return torch.stack(world)


@settings(deadline=None, max_examples=40)
@given(parents=trees, seed=st.integers(0, 1000), shared=st.booleans())
def test_forward_kinematics_of_any_tree(parents, seed, shared):
    generator = torch.Generator().manual_seed(seed)
    n = len(parents)
    rotations = random_rotations(3 * n, generator, torch.float64).view(3, n, 3, 3)
    joints = torch.randn(1 if shared else 3, n, 3, generator=generator, dtype=torch.float64)
    world, position = forward_kinematics(rotations, joints, parents, tree_levels(parents))
    for b in range(3):
        expected = textbook_transforms(rotations[b], joints[0 if shared else b], parents)
        torch.testing.assert_close(world[b], expected[:, :3, :3])
        torch.testing.assert_close(position[b], expected[:, :3, 3])


@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("batch", [0, 1, 7])
def test_skin_is_the_weighted_sum_over_joints(batch, shared):
    generator = torch.Generator().manual_seed(batch)
    rest = torch.randn(*(() if shared else (batch,)), 20, 3, generator=generator, dtype=torch.float64)
    weights = torch.rand(20, 16, generator=generator, dtype=torch.float64)
    rotations = random_rotations(batch * 16, generator, torch.float64).view(batch, 16, 3, 3)
    translations = torch.randn(batch, 16, 3, generator=generator, dtype=torch.float64)
    posed = skin(rest, weights, rotations, translations)
    assert posed.shape == (batch, 20, 3)
    for b in range(batch):
        for v in range(20):
            vertex = rest[v] if shared else rest[b, v]
            expected = sum(weights[v, j] * (rotations[b, j] @ vertex + translations[b, j]) for j in range(16))
            torch.testing.assert_close(posed[b, v], expected)


@pytest.mark.parametrize("shared", [True, False])
def test_skin_gradients_against_finite_differences(shared):
    generator = torch.Generator().manual_seed(0)
    rest = torch.randn(*(() if shared else (2,)), 4, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    weights = torch.rand(4, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    rotations = torch.randn(2, 3, 3, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    translations = torch.randn(2, 3, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(skin, (rest, weights, rotations, translations))


def test_levels_hold_each_joint_once_below_its_parent():
    levels = tree_levels(HAND)
    assert levels == [[0], [1, 4, 7, 10, 13], [2, 5, 8, 11, 14], [3, 6, 9, 12, 15]]


def test_a_child_before_its_parent_is_refused():
    with pytest.raises(ValueError, match="joint 1 has parent 2"):
        tree_levels([-1, 2, 0])


def test_homogeneous_appends_a_one():
    assert homogeneous(torch.tensor([[1.0, 2, 3]])).tolist() == [[1, 2, 3, 1]]
