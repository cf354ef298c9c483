"""Solving frames for body, hands and face from markers, against one frame after the other and plain derivatives."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.func import jacfwd, vmap

from grabnet.benchmarks.run import BenchmarkConfig
from grabnet.benchmarks.timing import Case
from grabnet.body.whole import BodyModel
from grabnet.io.shipped import shipped
from grabnet.mosh.attachment import Attachment, Pose
from grabnet.mosh.chains import solve_chains, solve_chains_densely
from grabnet.mosh.frames import damped_step, solve_frames
from grabnet.mosh.layouts import read_layout
from grabnet.mosh.priors import PriorConfig, joint_prior
from grabnet.mosh.so3 import exp
from grabnet.mosh.stage_one import on_trunk
from grabnet.mosh.stage_two import StageTwoConfig, frame_problem, stage_two, velocity_term

_RATE = 120.0
_PLAIN = 4  # frames of what is slow
_STEPS = 8  # of each frame by itself, from the pose before


def cases(settings: BenchmarkConfig) -> list[Case]:
    n, device = settings.batch, settings.device
    few = min(n, _PLAIN)
    generator = torch.Generator().manual_seed(settings.seed)
    body, prior, config = BodyModel.open(), PriorConfig(), StageTwoConfig()
    layout = read_layout(shipped("configs") / "mosh/layouts/open_body_grab99.yaml", len(body.v_template))
    latent = body.v_template[[marker.vertices[0] for marker in layout.markers]]
    attachment = Attachment(body, body.v_template, layout, latent, fixed=prior.fixed, device=device)
    pose = _moving(attachment, n, generator)
    noise = 0.001 * torch.randn(n, len(latent), 3, generator=generator)
    observed = attachment.place(pose).points.double() + noise.to(device)
    joints, trunk = joint_prior(body, prior), on_trunk(attachment)
    problem = frame_problem(attachment, observed, joints, prior, config)
    placed = attachment.place(pose)

    def one_by_one() -> Pose:
        last = pose.frames(slice(0, 1))
        for t in range(few):
            last, _ = solve_frames(problem.frames(slice(t, t + 1)), last, _STEPS)
        return last

    def plain_jacobian() -> Tensor:
        def points(delta: Tensor, *values: Tensor) -> Tensor:
            one = Pose(*(value.unsqueeze(0) for value in values))
            return attachment.place(attachment.moved(one, delta.unsqueeze(0))).points[0]

        return vmap(jacfwd(points))(observed.new_zeros(few, attachment.n).float(), *pose.frames(slice(0, few)))

    normal = problem.normal(pose)
    hessian, gradient = normal.hessian.double(), normal.gradient.double()
    coupling = velocity_term(attachment, _RATE, config).weight.double()
    hessian.diagonal(dim1=1, dim2=2).add_(2 * coupling)

    def chain(solve, frames: int) -> Tensor:
        return solve(hessian[:frames].unsqueeze(0).clone(), gradient[:frames].unsqueeze(0), coupling)

    return [
        Case("one frame after the other", one_by_one, runs=2, frames=few),
        Case(
            "Stage II, all frames",
            lambda: stage_two(attachment, observed, _RATE, joints, prior, config, trunk),
            ("one frame after the other",),
            frames=n,
        ),
        Case("part: derivatives, automatic", plain_jacobian, frames=few),
        Case(
            "part: derivatives", lambda: attachment.jacobian(pose, placed), ("part: derivatives, automatic",), frames=n
        ),
        Case("part: frames joined, one matrix", lambda: chain(solve_chains_densely, few), runs=2, frames=few),
        Case("part: frames joined", lambda: chain(solve_chains, n), ("part: frames joined, one matrix",), frames=n),
        Case("part: placing markers", lambda: attachment.place(pose), frames=n),
        Case("part: normal equations", lambda: problem.normal(pose), frames=n),
        Case("part: frames by themselves", lambda: damped_step(normal, torch.zeros(n, device=device)), frames=n),
    ]


def _moving(attachment: Attachment, n: int, generator: torch.Generator) -> Pose:
    """Frames of a smooth motion: every joint swings by up to a fifth of a radian."""
    time = torch.arange(n)[:, None, None] / _RATE
    swing = 0.1 * torch.randn(2, 55, 3, generator=generator)
    pose = attachment.neutral(n)
    pose.rotations[:] = exp(swing[0] * torch.sin(4 * time) + swing[1] * torch.sin(7 * time))
    return pose
