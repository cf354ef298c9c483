from __future__ import annotations

import torch

from grabnet.grasping.grasp_hand import GraspPose
from grabnet.grasping.spheres import overlaps


def test_overlap_of_spheres_is_that_of_exact_distances(hand):
    generator = torch.Generator().manual_seed(0)
    n = len(hand.radii)
    spheres = 0.3 + 0.05 * torch.randn(3, n, 3, generator=generator)
    apart = 0.02 * torch.rand(n, n, generator=generator)
    exact = (apart.double() - torch.cdist(spheres.double(), spheres.double())).clamp(min=0) * 1e3
    exact = exact * (1 - torch.eye(n))
    torch.testing.assert_close(overlaps(spheres, apart) * (1 - torch.eye(n)), exact.float(), atol=2e-3, rtol=0)


def test_a_flat_hand_does_not_overlap_itself_and_crossed_fingers_do(hand):
    clearance = hand.apart
    assert (clearance.diag() == 0).all()
    torch.testing.assert_close(clearance, clearance.T)
    rotation, wrist = torch.eye(3)[None], hand.joints[:1]
    flat = hand.posed(GraspPose(rotation, wrist, torch.zeros(1, 21)))
    assert overlaps(flat.spheres, clearance).max() < 1e-2
    crossed = torch.zeros(1, 21)
    crossed[0, 1], crossed[0, 5] = -0.3, 0.3  # index and middle finger towards each other
    assert overlaps(hand.posed(GraspPose(rotation, wrist, crossed)).spheres, clearance).max() > 3
