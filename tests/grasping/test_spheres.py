from __future__ import annotations

import torch

from grabnet.grasping.grasp_hand import GraspPose
from grabnet.grasping.spheres import SelfOverlap, overlaps


def spheres_and_clearance(n: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    apart = 0.02 * torch.rand(n, n, generator=generator)
    return 0.3 + 0.05 * torch.randn(3, n, 3, generator=generator), (apart + apart.T).fill_diagonal_(0)


def test_overlap_of_spheres_is_that_of_exact_distances():
    spheres, apart = spheres_and_clearance(60)
    exact = (apart.double() - torch.cdist(spheres.double(), spheres.double())).clamp(min=0) * 1e3
    torch.testing.assert_close(overlaps(spheres, apart), exact.float(), atol=2e-3, rtol=0)


def test_the_kernels_energy_and_gradient_are_those_of_the_formula():
    spheres, apart = spheres_and_clearance(60)
    ours, plain = spheres.clone().requires_grad_(), spheres.double().requires_grad_()
    energy, expected = SelfOverlap(apart)(ours), overlaps(plain, apart.double()).square().sum((1, 2)) / 2
    torch.testing.assert_close(energy.double(), expected, rtol=1e-4, atol=1e-3)
    weight = torch.tensor([1.0, 2.0, -1.0])
    (energy * weight).sum().backward()
    (expected * weight).sum().backward()
    torch.testing.assert_close(ours.grad.double(), plain.grad, rtol=1e-3, atol=1.0)  # of 10⁴ mm²/m


def test_spheres_in_one_place_give_numbers():
    spheres = torch.zeros(1, 2, 3, requires_grad=True)
    energy = SelfOverlap(torch.tensor([[0, 0.01], [0.01, 0]]))(spheres)
    energy.sum().backward()
    torch.testing.assert_close(energy, torch.tensor([100.0]), rtol=1e-3, atol=0)
    assert spheres.grad.isfinite().all()


def still(hand, **angles: float) -> GraspPose:
    value = torch.zeros(1, 21)
    for name, angle in angles.items():
        value[0, hand.anatomy.angle_names.index(name)] = angle
    return GraspPose(torch.eye(3)[None], hand.joints[:1], value)


def test_a_flat_hand_does_not_overlap_itself_and_crossed_fingers_do(hand):
    assert (hand.apart.diag() == 0).all()
    torch.testing.assert_close(hand.apart, hand.apart.T)
    flat = hand.posed(still(hand))
    assert overlaps(flat.spheres, hand.apart).max() < 1e-2
    crossed = hand.posed(still(hand, index_mcp_abduction=-0.3, middle_mcp_abduction=0.3))
    assert overlaps(crossed.spheres, hand.apart).max() > 3


def test_a_thumb_pressed_into_the_palm_overlaps(hand):
    pressed = hand.posed(still(hand, thumb_cmc_flexion=0.9))
    at_ease = hand.posed(still(hand, thumb_cmc_abduction=0.5, thumb_mcp=0.3))
    assert hand.self_overlap(pressed.spheres) > 100 * (hand.self_overlap(at_ease.spheres) + 0.1)


def test_spheres_are_the_same_however_the_model_lies(hand, turned, left):
    other, rotation = turned
    torch.testing.assert_close(other.radii, hand.radii, atol=1e-6, rtol=0)
    torch.testing.assert_close(left.radii, hand.radii, atol=1e-6, rtol=0)
    expected = hand.posed(still(hand)).spheres
    mirror = torch.tensor([-1.0, 1, 1])
    torch.testing.assert_close(other.posed(still(other)).spheres, expected @ rotation.mT, atol=1e-6, rtol=0)
    torch.testing.assert_close(left.posed(still(left)).spheres, expected * mirror, atol=1e-6, rtol=0)
