"""The parts of the solver against finite differences, dense matrices and each other, in double precision."""

from __future__ import annotations

import pytest
import torch

from grabnet.mosh.attachment import Attachment, Pose
from grabnet.mosh.chains import solve_chains, solve_chains_densely
from grabnet.mosh.frames import FrameProblem
from grabnet.mosh.priors import PriorConfig, joint_prior
from grabnet.mosh.so3 import exp, log, log_change
from grabnet.mosh.sweeps import Windows, _couple, sweep
from grabnet.mosh.terms import MarkerTerm, PosePrior, Velocity

STEP = 1e-6


def attachment_of(actor, shapes: int = 0, correctives: bool = False, **options) -> Attachment:
    generator = torch.Generator().manual_seed(1)
    directions = torch.randn(len(actor.body.v_template), 3, shapes, generator=generator) * 0.01 if shapes else None
    attachment = Attachment(
        actor.body, actor.body.v_template, actor.truth, actor.latent, directions, torch.float64, **options
    )
    if correctives:  # the open body has none
        attachment.correctives = 0.003 * torch.randn(99, 3, 54, 9, generator=generator, dtype=torch.float64)
    return attachment


def pose_of(actor, attachment: Attachment, frames: slice = slice(0, 2)) -> Pose:
    generator = torch.Generator().manual_seed(2)
    rotations = actor.rotations[frames]
    shape = torch.randn(len(rotations), attachment.n_shapes, generator=generator, dtype=torch.float64)
    return Pose(rotations, actor.transl[frames], shape)


def numeric(attachment: Attachment, pose: Pose, function) -> torch.Tensor:
    """(F, n, …) central differences of a function of poses and of which frame each is of, for all unknowns at once."""
    f, n = len(pose.transl), attachment.n
    frames = torch.arange(f).repeat_interleave(n)
    delta = STEP * torch.eye(n, dtype=torch.float64).repeat(f, 1)
    there, back = (function(attachment.moved(pose.frames(frames), sign * delta), frames) for sign in (1, -1))
    return ((there - back) / (2 * STEP)).unflatten(0, (f, n))


@pytest.mark.parametrize("case", [{}, {"shapes": 3}, {"correctives": True}, {"fixed": (0, 20)}])
def test_jacobian_of_markers(actor, case):
    attachment = attachment_of(actor, **case)
    pose = pose_of(actor, attachment)
    found = attachment.jacobian(pose, attachment.place(pose))
    expected = numeric(attachment, pose, lambda p, _: attachment.place(p).points.flatten(1))
    torch.testing.assert_close(found, expected, atol=1e-7, rtol=1e-6)


def test_markers_on_vertices_lie_where_skinning_of_the_whole_body_puts_them(actor):
    corners = torch.tensor([marker.vertices[0] for marker in actor.layout.markers])
    attachment = Attachment(actor.body, actor.body.v_template, actor.layout, actor.body.v_template[corners])
    pose = Pose(actor.rotations.float(), actor.transl.float(), torch.zeros(len(actor.transl), 0))
    torch.testing.assert_close(attachment.place(pose).points, actor.vertices[:, corners], atol=2e-6, rtol=0)


def problem_of(
    actor, attachment: Attachment, frames: slice, reach: float = 5.0, settings: PriorConfig | None = None
) -> FrameProblem:
    observed = torch.as_tensor(actor.markers[frames]).clone()
    observed[:, 3] += 0.02  # an outlier
    observed[0, 10:14] = torch.nan
    prior = PosePrior(
        attachment, joint_prior(actor.body, settings or PriorConfig()), torch.ones(attachment.n_shapes).double()
    )
    sigma = torch.full((attachment.n_markers,), 0.002, dtype=torch.float64)
    factor = torch.linspace(1, 2, len(observed)).double()
    return FrameProblem(attachment, MarkerTerm(observed, sigma, reach), prior, factor)


HANDS = PriorConfig(hand_components=6)


@pytest.mark.parametrize("case", [{}, {"settings": HANDS}, {"settings": HANDS, "fixed": (27, 40)}])
def test_gradient_of_markers_and_prior(actor, case):
    attachment = attachment_of(actor, shapes=2, fixed=case.pop("fixed", ()))
    pose = pose_of(actor, attachment)
    problem = problem_of(actor, attachment, slice(0, 2), **case)
    normal = problem.normal(pose)
    torch.testing.assert_close(normal.cost, problem.cost(pose))
    expected = numeric(attachment, pose, lambda p, frames: problem.frames(frames).cost(p))
    torch.testing.assert_close(normal.gradient, expected, atol=1e-3, rtol=1e-5)


def test_hessian_of_markers_and_prior_without_outliers_is_that_of_their_jacobians(actor):
    attachment = attachment_of(actor)
    pose = pose_of(actor, attachment)
    problem = problem_of(actor, attachment, slice(0, 2), float("inf"))

    def off(p: Pose, frames: torch.Tensor) -> torch.Tensor:
        return problem.frames(frames).markers.residuals(attachment.place(p)).flatten(1)

    jacobian = numeric(attachment, pose, off)
    root = torch.linalg.cholesky(problem.prior.precision[1:]).mT  # the pelvis is free

    def pulled(p: Pose, frames: torch.Tensor) -> torch.Tensor:
        off = log(p.rotations[:, attachment.joints]) - problem.prior.mean
        return (root @ off[:, 1:].unsqueeze(-1)).flatten(1) * problem.factor[frames].sqrt().unsqueeze(1)

    prior = numeric(attachment, pose, pulled)
    expected = jacobian @ jacobian.mT + prior @ prior.mT
    torch.testing.assert_close(problem.normal(pose).hessian, expected, atol=2e-2, rtol=1e-5)


def test_hands_prior_is_a_gaussian_along_the_components_and_beside(actor):
    """Curvature of the cost in a few directions, at the mean, where steps on rotations and rotation vectors agree."""
    attachment, prior = attachment_of(actor), joint_prior(actor.body, HANDS)
    markers = torch.full((1, 99, 3), torch.nan)
    term = PosePrior(attachment, prior, torch.zeros(0))
    problem = FrameProblem(attachment, MarkerTerm(markers, torch.ones(99).double(), 5.0), term, torch.ones(1).double())
    mean, components = actor.body.hands_meanr.double(), actor.body.hands_componentsr.double()
    for k, spread in ((0, 0.6), (5, 0.6), (6, 0.05), (44, 0.05)):
        costs = []
        for step in (0.0, spread, 2 * spread):
            pose = attachment.neutral(1)
            pose.rotations[:, 40:55] = exp((mean + step * components[k]).view(15, 3))
            costs.append(problem.cost(pose).item())
        assert costs[1] - costs[0] == pytest.approx(0.5) and costs[2] - costs[0] == pytest.approx(2.0)


def test_gradient_of_the_velocity_term(actor):
    attachment = attachment_of(actor, shapes=2)
    pose = pose_of(actor, attachment, slice(0, 24, 8))
    weight = torch.linspace(1, 2, attachment.n).double()
    weight[3:-2] = weight[3:-2].view(-1, 3).mean(1).repeat_interleave(3)  # the same about all axes of a joint
    velocity = Velocity(weight, attachment.joints)

    def total(p: Pose) -> torch.Tensor:
        steps = velocity.steps(p.frames(slice(0, -1)), p.frames(slice(1, None)))
        return velocity.cost(steps).sum().expand(3)

    steps = velocity.steps(pose.frames(slice(0, -1)), pose.frames(slice(1, None)))
    gradient = torch.zeros(3, attachment.n, dtype=torch.float64)
    _couple(velocity, steps, 0, 3, torch.zeros(3, attachment.n, attachment.n).double(), gradient)
    for frame in range(3):
        for k in range(0, attachment.n, 7):
            delta = torch.zeros(3, attachment.n, dtype=torch.float64)
            delta[frame, k] = STEP
            there, back = (total(attachment.moved(pose, sign * delta))[0] for sign in (1, -1))
            assert gradient[frame, k].item() == pytest.approx(((there - back) / (2 * STEP)).item(), abs=1e-6)


def test_change_of_the_logarithm():
    generator = torch.Generator().manual_seed(0)
    vector = 0.7 * torch.randn(20, 3, generator=generator, dtype=torch.float64)
    vector[0] = 1e-5
    for k in range(3):
        delta = torch.zeros(3, dtype=torch.float64)
        delta[k] = STEP
        there, back = (log(exp(vector) @ exp(sign * delta)) for sign in (1, -1))
        torch.testing.assert_close(log_change(vector)[..., k], (there - back) / (2 * STEP), atol=1e-6, rtol=1e-5)
    torch.testing.assert_close(exp(vector), torch.linalg.matrix_exp(
        torch.stack([torch.linalg.cross(v.expand(3, 3), torch.eye(3).double()).mT for v in vector])
    ))  # fmt: skip


@pytest.mark.parametrize("length", [1, 2, 7])
def test_chains_against_one_dense_matrix(length):
    generator = torch.Generator().manual_seed(length)
    root = torch.randn(3, length, 5, 5, generator=generator, dtype=torch.float64)
    hessian = root @ root.mT + 4 * torch.eye(5)
    gradient = torch.randn(3, length, 5, generator=generator, dtype=torch.float64)
    coupling = torch.rand(5, generator=generator, dtype=torch.float64)
    expected = solve_chains_densely(hessian, gradient, coupling)
    torch.testing.assert_close(solve_chains(hessian.clone(), gradient, coupling), expected)


def test_sweeps_in_windows_reach_what_one_window_reaches(actor):
    attachment = attachment_of(actor)
    problem = problem_of(actor, attachment, slice(0, 12), 50.0)
    sigma = torch.cat([torch.full((3,), 0.01), torch.full((attachment.n - 3,), 0.1)]).double()
    velocity = Velocity(sigma**-2, attachment.joints)
    ends = []
    for windows in (Windows(12, 1), Windows(5, 2)):
        pose = pose_of(actor, attachment, slice(0, 12))
        damping = torch.full((12,), 1e-6, dtype=torch.float64)
        for number in range(20):
            pose = sweep(problem, velocity, pose, damping, windows, number)
        ends.append(pose)
    torch.testing.assert_close(ends[0].rotations, ends[1].rotations, atol=1e-2, rtol=0)
    torch.testing.assert_close(ends[0].transl, ends[1].transl, atol=1e-3, rtol=0)
