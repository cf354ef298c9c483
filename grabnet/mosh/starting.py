"""Poses to start from: the resting body laid over the markers, then let go joint by joint."""

from __future__ import annotations

import torch
from torch import Tensor

from grabnet.mosh.attachment import Attachment, Pose
from grabnet.mosh.frames import FrameProblem, solve_frames
from grabnet.mosh.priors import JointPrior
from grabnet.mosh.rigid import align
from grabnet.mosh.so3 import exp

# Reach of the markers, standard deviations, from far to near: those far off pull at first, and are outliers later.
_REACHES = (200.0, 60.0, 20.0)


def start(problem: FrameProblem, prior: JointPrior, trunk: Tensor, iterations: int = 12) -> tuple[Pose, Tensor]:
    """Poses of frames about which nothing is known.

    The body in its usual pose is turned by the markers of the trunk where three are seen, and otherwise by all; then
    everything is solved for, with a reach of the markers that shrinks.

    Args:
        problem: of F frames.
        prior: whose mean is the usual pose.
        trunk: (M,) which markers are on the trunk.
        iterations: for each reach.

    Returns:
        the poses and their costs (F,).
    """
    attachment = problem.attachment
    pose = _laid_over(attachment, problem.markers.observed, prior, trunk)
    cost = None
    for reach in _REACHES:
        pose, cost = solve_frames(problem.reaching(reach), pose, iterations)
    return pose, cost


def _laid_over(attachment: Attachment, observed: Tensor, prior: JointPrior, trunk: Tensor) -> Pose:
    neutral = attachment.neutral(len(observed))
    usual = exp(prior.mean.to(attachment.device, attachment.dtype))
    neutral.rotations[:, 1:] = usual[1:]
    resting = attachment.place(neutral).points
    seen = observed[..., 0].isfinite()
    enough = (seen & trunk).sum(1) >= 4
    used = torch.where(enough.unsqueeze(1), seen & trunk, seen)
    rotation, translation = align(resting.double(), observed.double(), used.double())
    root = attachment.rest_joints[0].double()
    neutral.rotations[:, 0] = rotation.to(attachment.dtype) @ neutral.rotations[:, 0]
    neutral.transl[:] = (rotation @ root + translation - root).to(attachment.dtype)
    return neutral
