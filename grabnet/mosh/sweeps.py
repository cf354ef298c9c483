"""Gauss-Newton over a whole recording, whose frames are joined by the velocity term.

A sweep cuts the recording into windows, several of which are solved side by side. What lies beyond a window's ends is
held as it is; the next sweep cuts elsewhere. Memory holds one group of windows, however long the recording.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from grabnet.mosh.attachment import Pose
from grabnet.mosh.chains import solve_chains
from grabnet.mosh.frames import FrameProblem
from grabnet.mosh.terms import Velocity


@dataclass(frozen=True)
class Windows:
    """length: frames of a window. at_once: windows solved side by side. smooth: frames over which expected changes are
    averaged, as the standard deviation of a Gaussian; 0 to expect that nothing moves."""

    length: int = 64
    at_once: int = 4
    smooth: float = 0.0


def sweep(
    problem: FrameProblem,
    velocity: Velocity,
    pose: Pose,
    damping: Tensor,
    windows: Windows,
    number: int,
    progress: Callable[[float], None] = lambda share: None,
) -> Pose:
    """One step for every frame.

    Args:
        problem: of all T frames.
        velocity: the term that joins frames.
        pose: of all frames; stays as it is.
        damping: (T,) of each frame, updated: windows that would get worse stay, and take shorter steps next.
        windows: how the recording is cut.
        number: of the sweep, which decides where.
        progress: is given the share of the frames that a group of windows has, after each.

    Returns:
        the new poses.
    """
    t, result = len(damping), Pose(*(value.clone() for value in pose))
    steps = velocity.steps(pose.frames(slice(0, t - 1)), pose.frames(slice(1, t)))
    expected = _smooth(steps, windows.smooth) if windows.smooth else torch.zeros_like(steps)
    first = -(windows.length // 2) * (number % 2)
    starts = [s for s in range(first, t, windows.length) if s + windows.length > 0]
    for group in range(0, len(starts), windows.at_once):
        now = starts[group : group + windows.at_once]
        low, high = max(0, now[0]), min(t, now[-1] + windows.length)
        frames = slice(low, high)
        part, here = problem.frames(frames), pose.frames(frames)
        normal = part.normal(here)
        cost = normal.cost
        hessian, gradient = normal.hessian.double(), normal.gradient.double()
        _couple(velocity, steps - expected, low, high, hessian, gradient)
        diagonal = hessian.diagonal(dim1=1, dim2=2)
        diagonal.mul_(1 + damping[frames].unsqueeze(1)).add_(1e-6 * diagonal.mean(1, keepdim=True))
        delta = torch.cat(
            [_solved(hessian, gradient, velocity, piece) for piece in _pieces(now, low, high, windows.length)]
        )
        there = part.attachment.moved(here, delta.to(part.attachment.dtype))
        window = (torch.arange(low, high, device=cost.device) - now[0]) // windows.length
        before = cost + _joined(velocity, here, expected, low, high)
        after = part.cost(there) + _joined(velocity, there, expected, low, high)
        change = delta.new_zeros(len(now)).index_add_(0, window, (after - before).double())
        worse = (change > 1e-6 * before.sum())[window]
        damping[frames] = torch.where(worse, damping[frames] * 10, damping[frames] * 0.2).clamp(1e-6, 1e3)
        result.put(torch.arange(low, high, device=cost.device)[~worse], there.frames(~worse))
        progress((high - low) / t)
    return result


def _couple(velocity: Velocity, off: Tensor, low: int, high: int, hessian: Tensor, gradient: Tensor) -> None:
    """Add the velocity term of frames low … high - 1 to their blocks; their neighbours beyond are held."""
    n = len(off) + 1
    before, after = slice(max(low - 1, 0), high - 1), slice(low, min(high, n - 1))
    pull_before, pull_after = velocity.weight * off[before], velocity.weight * off[after]
    gradient[len(gradient) - len(pull_before) :] += pull_before
    gradient[: len(pull_after)] -= pull_after
    diagonal = hessian.diagonal(dim1=1, dim2=2)
    diagonal[len(gradient) - len(pull_before) :] += velocity.weight
    diagonal[: len(pull_after)] += velocity.weight


def _pieces(starts: list[int], low: int, high: int, length: int) -> list[tuple[int, int, int]]:
    """Runs of windows of equal length: (first frame counted from low, windows, length of each)."""
    ends = [(max(s, low), min(s + length, high)) for s in starts]
    pieces: list[tuple[int, int, int]] = []
    for a, b in ends:
        if pieces and pieces[-1][2] == b - a:
            pieces[-1] = (pieces[-1][0], pieces[-1][1] + 1, b - a)
        else:
            pieces.append((a - low, 1, b - a))
    return pieces


def _solved(hessian: Tensor, gradient: Tensor, velocity: Velocity, piece: tuple[int, int, int]) -> Tensor:
    first, n_windows, length = piece
    now = slice(first, first + n_windows * length)
    shape = (n_windows, length)
    steps = solve_chains(hessian[now].unflatten(0, shape), gradient[now].unflatten(0, shape), velocity.weight.double())
    return steps.flatten(0, 1)


def _joined(velocity: Velocity, pose: Pose, expected: Tensor, low: int, high: int) -> Tensor:
    """(F,) cost of the changes before and after each frame of a group, within it."""
    steps = velocity.steps(pose.frames(slice(0, -1)), pose.frames(slice(1, None))) - expected[low : high - 1]
    cost = velocity.cost(steps)
    joined = cost.new_zeros(high - low)
    joined[1:] += cost / 2
    joined[:-1] += cost / 2
    return joined


def _smooth(steps: Tensor, sigma: float) -> Tensor:
    """Each change averaged with those around it, weighed by a Gaussian."""
    reach = int(3 * sigma)
    kernel = torch.exp(-0.5 * (torch.arange(-reach, reach + 1, dtype=steps.dtype, device=steps.device) / sigma) ** 2)
    padded = torch.nn.functional.pad(steps.T.unsqueeze(1), (reach, reach), mode="replicate")
    return torch.nn.functional.conv1d(padded, (kernel / kernel.sum()).view(1, 1, -1)).squeeze(1).T
