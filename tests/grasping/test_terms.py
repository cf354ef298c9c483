"""Each term against finite differences, and what it prevents."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor
from torch.nn.functional import normalize

from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.grasping import terms
from grabnet.grasping.forces import ForceConfig, HeldForces
from grabnet.grasping.grasp_hand import GraspHand, GraspPose
from grabnet.grasping.obstacles import ObstacleConfig, Obstacles
from grabnet.grasping.seen import Pads, Seen
from grabnet.grasping.spheres import overlaps

from .surfaces import ball

WEIGHT = torch.linspace(0.2, 1, 19, dtype=torch.float64)
SHARE = (WEIGHT / WEIGHT[3:].sum()).clone()
SHARE[:3] = 0
THUMB = 2  # its tip's pad


def held_forces(pads: Pads) -> Tensor:
    forces = HeldForces(pads.place[:, 0], pads.place.shape[1], ForceConfig(iterations=300, effort=0.3))
    return forces.unmet(pads, pads.place.new_tensor([[0.0, -0.035, 0.0]]), solve=True)


def obstacles(hand: GraspHand, seen: Seen) -> Tensor:
    return Obstacles(hand, ObstacleConfig(), floor=-0.03)(seen)


TERMS: dict[str, Callable[[GraspHand, GraspPose, Seen], Tensor]] = {
    "contact": lambda hand, pose, seen: terms.contact(seen.pads, WEIGHT, -0.6, 40),
    "alignment": lambda hand, pose, seen: terms.alignment(seen.pads, WEIGHT),
    "opposition": lambda hand, pose, seen: terms.opposition(seen.pads, THUMB, SHARE),
    "obstacles": lambda hand, pose, seen: obstacles(hand, seen),
    "self_overlap": lambda hand, pose, seen: overlaps(seen.sampled.spheres, hand.apart).square().sum((1, 2)) / 2,
    "beyond_limits": lambda hand, pose, seen: terms.beyond_limits(2 * pose.angles, hand.anatomy.angle_limits),
    "strayed": lambda hand, pose, seen: terms.strayed(pose.wrist, torch.zeros_like(pose.wrist), 0.02),
    "force": lambda hand, pose, seen: held_forces(seen.pads),
}


@pytest.mark.parametrize("name", TERMS)
def test_gradient_matches_finite_differences(name, precise):
    generator = torch.Generator().manual_seed(1)
    n, double = 3, torch.float64
    angles = 0.3 + 0.4 * torch.rand(n, 21, generator=generator, dtype=double)
    turn = 0.3 * torch.randn(n, 3, generator=generator, dtype=double)
    wrist = precise.joints[:1] + 0.01 * torch.randn(n, 3, generator=generator, dtype=double)
    formula = ball(0.025, torch.tensor([0.0, -0.035, 0.0]))
    x = torch.cat([turn, wrist, angles], 1).requires_grad_()
    first = Seen.of(precise, _pose(x), formula, 1e-6)

    def value(x: Tensor) -> Tensor:
        # So little softness that a pad is its deepest vertex: the shares, constants to autograd, then are constant. The
        # object's normals are constants, too.
        seen = Seen.of(precise, _pose(x), formula, 1e-6)
        seen = seen._replace(pads=seen.pads._replace(surface=first.pads.surface.detach()))
        return TERMS[name](precise, _pose(x), seen)

    (gradient,) = torch.autograd.grad(value(x).sum(), x)
    assert gradient.abs().max() > 0.1
    with torch.no_grad():
        for column in range(x.shape[1]):
            shift = torch.zeros_like(x)
            shift[:, column] = step = 1e-7
            numeric = (value(x + shift) - value(x - shift)) / (2 * step)
            torch.testing.assert_close(gradient[:, column], numeric, rtol=1e-3, atol=2e-3)


def _pose(x: Tensor) -> GraspPose:
    return GraspPose(axis_angle_to_matrix(x[:, :3]), x[:, 3:6], x[:, 6:])


def pads(places: list, normals: list, gaps: list) -> Pads:
    """One hand's pads of one vertex each, facing the surface."""
    place, normal = torch.tensor(places)[None], normalize(torch.tensor(normals), dim=-1)[None]
    gap = torch.tensor(gaps)[None, :, None]
    return Pads(gap, torch.ones_like(gap), place, normal, -normal)


PINCH = ([[-0.02, 0.0, 0], [0.02, 0, 0]], [[-1.0, 0, 0], [1, 0, 0]])  # a ball of 2 cm between two fingers


def test_contact_draws_pads_to_the_target_and_no_further():
    weight = torch.ones(2)
    values = [float(terms.contact(pads(*PINCH, [g, g]), weight, -0.6, 40)) for g in (10.0, 3.0, -0.6, -3.0, 100.0)]
    assert values[0] > values[1] > values[2] < values[3]
    assert values[4] == 80  # too far to pull


def test_alignment_prevents_touching_with_the_back_of_a_finger():
    facing = pads(*PINCH, [0.0, 0.0])
    away = facing._replace(facing=-facing.facing)
    assert terms.alignment(facing, torch.ones(2)) == 0
    assert terms.alignment(away, torch.ones(2)) == 4


def test_opposition_prevents_thumb_and_fingers_on_one_side():
    share = torch.tensor([[0.0, 1.0]])
    across = terms.opposition(pads(*PINCH, [0.0, 0.0]), 0, share)
    beside = terms.opposition(pads([[-0.02, 0.0, 0], [-0.02, 0.01, 0]], [[-1.0, 0, 0]] * 2, [0.0, 0.0]), 0, share)
    assert across == 0
    assert beside > 1.5


def test_overlap_counts_what_is_nearer_than_its_reach_and_grows_in_proportion_where_deep():
    distance = torch.tensor([[5.0, 2.0, -1.0]])
    torch.testing.assert_close(terms.overlap(distance, torch.tensor([4.0, 4.0, -0.5])), torch.tensor([4.0 + 0.25]))
    slope = terms.overlap(torch.tensor([[-20.0], [-21.0]]), 0.0).diff()
    torch.testing.assert_close(slope, torch.tensor([2 * terms.DEEP]))


def test_spheres_notice_a_thin_wall_that_skin_has_passed():
    wall = 1.0  # mm, half its thickness; a finger of 8 mm across it
    skin, sphere = torch.tensor([[8 - wall, 8 - wall]]), torch.tensor([[-wall]])
    assert terms.overlap(skin, -1.0) == 0
    assert terms.overlap(sphere, 7.0) > 20


def test_the_table_is_not_gone_through():
    assert terms.below_table(torch.tensor([[3.0, 1.0]]), 1.0) == 0
    assert terms.below_table(torch.tensor([[3.0, -1.0]]), 1.0) == 4
