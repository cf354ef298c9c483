"""The problem of solving frames for their poses: markers and prior, without what joins a frame to the next."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from grabnet.mosh.attachment import Attachment, Pose
from grabnet.mosh.terms import MarkerTerm, Normal, PosePrior


@dataclass(frozen=True)
class FrameProblem:
    """F frames to solve.

    Attributes:
        attachment: of the markers.
        markers: where they were seen.
        prior: of pose and shape.
        factor: (F,) by which each frame's prior is multiplied.
    """

    attachment: Attachment
    markers: MarkerTerm
    prior: PosePrior
    factor: Tensor

    def frames(self, chosen: Tensor | slice) -> FrameProblem:
        """Chosen frames."""
        markers = replace(self.markers, observed=self.markers.observed[chosen])
        return replace(self, markers=markers, factor=self.factor[chosen])

    def reaching(self, reach: float) -> FrameProblem:
        """The same with another reach of the markers."""
        return replace(self, markers=replace(self.markers, reach=reach))

    def cost(self, pose: Pose) -> Tensor:
        """(F,)"""
        return self.markers.cost(self.attachment.place(pose)) + self.prior.cost(pose, self.factor)

    def normal(self, pose: Pose) -> Normal:
        """The frames' normal equations at a pose."""
        f, n, transl = len(pose.transl), self.attachment.n, pose.transl
        normal = Normal(transl.new_zeros(f, n, n), transl.new_zeros(f, n), transl.new_zeros(f))
        placed = self.attachment.place(pose)
        self.markers.add_to(normal, placed, self.attachment.jacobian(pose, placed))
        self.prior.add_to(normal, pose, self.factor)
        return normal


def missing_factor(observed: Tensor, growth: float) -> Tensor:
    """(F,) factor of the prior for markers (F, M, 3), of which some are missing (ref. 5)."""
    return 1 + growth * observed[..., 0].isnan().to(observed.dtype).mean(-1)


def solve_frames(
    problem: FrameProblem,
    pose: Pose,
    iterations: int,
    batch: int = 128,
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[Pose, Tensor]:
    """Levenberg-Marquardt on each frame by itself, many at once; a frame that gets worse takes a shorter step next.

    Args:
        problem: of F frames.
        pose: to start from.
        iterations: at most; frames that don't improve any more are left alone.
        batch: frames at once, which bounds memory.
        progress: is given the share of the frames that a batch has, after each.

    Returns:
        the poses, and their costs (F,).
    """
    n_frames, parts = len(pose.transl), []
    for start in range(0, n_frames, batch):
        now = slice(start, start + batch)
        parts.append(_solve(problem.frames(now), pose.frames(now), iterations))
        progress(len(parts[-1][1]) / n_frames)
    return Pose(*(torch.cat(values) for values in zip(*(p for p, _ in parts), strict=True))), torch.cat(
        [cost for _, cost in parts]
    )


def _solve(problem: FrameProblem, pose: Pose, iterations: int) -> tuple[Pose, Tensor]:
    attachment = problem.attachment
    pose = Pose(*(value.clone() for value in pose))
    damping = torch.full_like(pose.transl[:, 0], 1e-3, dtype=torch.float64)
    cost = problem.cost(pose)
    active = torch.arange(len(cost), device=cost.device)
    for _ in range(iterations):
        if not len(active):
            break
        some, here = problem.frames(active), pose.frames(active)
        normal = some.normal(here)
        step = damped_step(normal, damping[active])
        there = attachment.moved(here, step.to(attachment.dtype))
        new = some.cost(there)
        better = new < cost[active]
        gain = (cost[active] - new) / cost[active].clamp_min(1e-9)
        pose.put(active[better], there.frames(better))
        cost[active[better]] = new[better]
        damping[active] = torch.where(better, damping[active] * 0.2, damping[active] * 10).clamp(1e-6, 1e4)
        done = (better & (gain < 1e-4)) | (~better & (damping[active] > 1e2))
        active = active[~done]
    return pose, cost


def damped_step(normal: Normal, damping: Tensor) -> Tensor:
    """(F, n) steps of Levenberg and Marquardt, float64; the diagonal grows by a share of itself."""
    hessian = normal.hessian.double()
    diagonal = hessian.diagonal(dim1=1, dim2=2)
    diagonal.mul_(1 + damping.unsqueeze(1)).add_(1e-6 * diagonal.mean(1, keepdim=True))
    factor, _ = torch.linalg.cholesky_ex(hessian)
    return -torch.cholesky_solve(normal.gradient.double().unsqueeze(-1), factor).squeeze(-1)
