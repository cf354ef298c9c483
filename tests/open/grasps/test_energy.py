from __future__ import annotations

import torch

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.grasping.grasp_hand import GraspHand, GraspPose
from grabnet.grasping.proposing.posture import PostureConfig
from grabnet.grasping.proposing.proposals import Proposals
from grabnet.grasping.proposing.templates import KINDS
from grabnet.grasping.spheres import overlaps
from grabnet.open.grasps.energy import EnergyConfig, SynthesisEnergy

from ...grasping.scenes import ball


def test_gradient_matches_finite_differences():
    model = HandModel.open(dtype=torch.float64)
    hand = GraspHand(model, Anatomy.of(model), torch.zeros(10, dtype=torch.float64))
    hand.self_overlap = lambda spheres: overlaps(spheres, hand.apart).square().sum((1, 2)) / 2  # in double precision
    n = len(KINDS)
    generator = torch.Generator().manual_seed(1)
    angles = 0.3 + 0.4 * torch.rand(n, 21, generator=generator, dtype=torch.float64)
    turn = 0.3 * torch.randn(n, 3, generator=generator, dtype=torch.float64)
    wrist = hand.joints[:1] + 0.01 * torch.randn(n, 3, generator=generator, dtype=torch.float64)
    start = GraspPose(axis_angle_to_matrix(turn), wrist, angles)
    none = torch.zeros(n, dtype=torch.int64)
    forward = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64).expand(n, 3)
    proposals = Proposals(start, torch.arange(n), none, none == 0, forward)
    scene = ball(0.025, (0.0, -0.035, 0.0))
    scene.floor = -0.03
    energy = SynthesisEnergy(scene, hand, proposals, angles + 0.1, EnergyConfig(), PostureConfig())

    def value(x):
        # So little softness that a pad is its deepest vertex: the shares, constants to autograd, then are constant.
        return energy(GraspPose(axis_angle_to_matrix(x[:, :3]), x[:, 3:6], x[:, 6:]), 1e-6, 1.3)

    x = torch.cat([turn, wrist, angles], 1).requires_grad_()
    (gradient,) = torch.autograd.grad(value(x).sum(), x)
    step = 1e-7
    with torch.no_grad():
        for column in range(x.shape[1]):
            shift = torch.zeros_like(x)
            shift[:, column] = step
            numeric = (value(x + shift) - value(x - shift)) / (2 * step)
            torch.testing.assert_close(gradient[:, column], numeric, rtol=2e-4, atol=2e-3)
