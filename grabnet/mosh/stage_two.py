"""Stage II: the pose of every frame, given where the markers sit (paper 3.2, S.8).

Few frames are solved from nothing, more from what lies between those, then these together, and then all from what lies
between: a handful of Gauss-Newton sweeps suffices. Markers in doubt are left out until the body's pose can say what
their labels are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor

from grabnet.cli.checks import Batch, Count, Positive, Range, Weight, in_range
from grabnet.errors import UserError
from grabnet.mosh.attachment import Attachment, Pose
from grabnet.mosh.doubting import undoubted
from grabnet.mosh.frames import FrameProblem, missing_factor, solve_frames
from grabnet.mosh.priors import JointPrior, PriorConfig
from grabnet.mosh.relabelling import relabelled
from grabnet.mosh.so3 import exp, log
from grabnet.mosh.starting import start
from grabnet.mosh.sweeps import Windows, sweep
from grabnet.mosh.terms import MarkerTerm, PosePrior, Velocity

_BATCH = 256  # frames whose labels are looked at together, which bounds memory
_FINGERS = 25  # the first joint of a hand
_ROUGH, _FINE = 0.5, 1 / 15  # seconds between frames solved from nothing, and from what lies between those
_REACH = 20.0  # of the markers where a pose may be far off, standard deviations
_TURNED = 0.6  # radians that no joint turns in between two frames that are not far apart
_DOUBTFUL = 1.5  # times the usual cost
_FIRST = 0.25  # share of the work, about, that the first poses take
_FAILED = 4.0  # times the usual cost of a marker: a frame whose markers cost more lies otherwise than it should


@dataclass(frozen=True)
class StageTwoConfig:
    """How frames are solved.

    Attributes:
        noise: standard deviation of a marker, its place on the skin and the model's error included, metres.
        reach: standard deviations beyond which a marker loses its say.
        turn: standard deviation of a joint's change per frame from the expected one, radians, at 120 frames per second.
        finger_turn: of a finger's joint.
        shift: of the body's place, metres.
        smooth: seconds over which the expected change is averaged; 0 to expect none.
        sweeps: over all frames.
        window, windows: frames of a window and windows side by side, which bound memory.
        stretch: frames that are solved as one recording; longer ones are cut, which bounds memory, too.
        doubt: metres by which a marker's distances to its neighbours may be unusual; see `undoubted`.
        relabel: metres within which a marker that fits another label than its own takes that; see `relabelled`.

    Raises:
        UserError: a value out of range.
    """

    noise: Positive = 0.0018
    reach: Positive = 8.0
    turn: Positive = 0.004
    finger_turn: Positive = 0.01
    shift: Positive = 0.001
    smooth: Weight = 0.03
    sweeps: Count = 3
    window: Annotated[int, Range(2, 65_536)] = 64
    windows: Batch = 4
    stretch: Annotated[int, Range(16, 1_000_000)] = 8192
    doubt: Positive = 0.005
    relabel: Positive = 0.01

    def __post_init__(self):
        in_range(self, "stage_two.")


def stage_two(
    attachment: Attachment,
    observed: Tensor,
    rate: float,
    prior: JointPrior,
    prior_config: PriorConfig,
    config: StageTwoConfig,
    trunk: Tensor,
    progress: Callable[[float], None] = lambda share: None,
) -> Pose:
    """Solve a recording.

    Args:
        attachment: of the markers, at their latent places.
        observed: (T, M, 3) where they were seen, metres; NaN where missing.
        rate: frames per second.
        prior, prior_config: of poses.
        config: the settings.
        trunk: (M,) which markers are on the trunk.
        progress: is given shares of all the work, as they are done.

    Raises:
        UserError: no frame shows three markers.
    """
    shown = observed[..., 0].isfinite().sum(1) >= 3
    if not shown.any():
        raise UserError("no frame shows three markers of the body")
    t = len(observed)
    result, known = attachment.neutral(t), torch.zeros_like(shown)
    for first, end in _stretches(t, config.stretch):
        share = (end - first) / t
        if not shown[first:end].any():
            progress(share)
            continue
        pose = _solved(
            attachment,
            observed[first:end],
            rate,
            prior,
            prior_config,
            config,
            trunk,
            lambda s, share=share: progress(s * share),
        )
        shared = known[first:end].nonzero().squeeze(1)  # with the stretch before: from its poses to the new ones
        fade = (shared + 1).to(pose.transl.dtype) / (len(shared) + 1)
        pose.put(shared, mixed(result.frames(first + shared), pose.frames(shared), fade))
        result.put(slice(first, end), pose)
        known[first:end] = True
    at = known.nonzero().squeeze(1)
    return result if len(at) == t else between(result.frames(at), at, torch.arange(t, device=at.device))


def _stretches(t: int, length: int) -> list[tuple[int, int]]:
    """First frame and end of stretches, each of which overlaps with the next."""
    overlap = length // 16
    return [(first, min(first + length, t)) for first in range(0, max(1, t - overlap), length - overlap)]


def _solved(
    attachment: Attachment,
    observed: Tensor,
    rate: float,
    prior: JointPrior,
    prior_config: PriorConfig,
    config: StageTwoConfig,
    trunk: Tensor,
    progress: Callable[[float], None],
) -> Pose:
    """Solve a stretch; arguments as of `stage_two`."""
    t = len(observed)
    seen = undoubted(observed, config.doubt)
    problem = frame_problem(attachment, seen, prior, prior_config, config)
    pose = _first_poses(problem, prior, trunk, rate, config, lambda share: progress(_FIRST * share))
    velocity = velocity_term(attachment, rate, config)
    windows = Windows(config.window, config.windows, config.smooth * rate)
    damping = torch.full((t,), 1e-4, dtype=torch.float64, device=observed.device)
    for number in range(config.sweeps if t > 1 else 0):
        labelled = put_right(attachment, pose, observed, config.relabel)
        problem = frame_problem(attachment, labelled, prior, prior_config, config)
        pose = sweep(
            problem, velocity, pose, damping, windows, number,
            lambda share: progress((1 - _FIRST) / config.sweeps * share),
        )  # fmt: skip
    return pose


def put_right(attachment: Attachment, pose: Pose, observed: Tensor, reach: float) -> Tensor:
    """Markers (T, M, 3) under the labels that they fit in solved poses; see `relabelled`."""
    parts = [slice(start, start + _BATCH) for start in range(0, len(observed), _BATCH)]
    return torch.cat([relabelled(attachment.place(pose.frames(now)).points, observed[now], reach) for now in parts])


def frame_problem(
    attachment: Attachment, observed: Tensor, prior: JointPrior, prior_config: PriorConfig, config: StageTwoConfig
) -> FrameProblem:
    """The frames by themselves."""
    observed = observed.to(attachment.dtype)
    sigma = torch.full((attachment.n_markers,), config.noise, dtype=attachment.dtype, device=attachment.device)
    shape_sigma = torch.full((attachment.n_shapes,), prior_config.expression, device=attachment.device)
    return FrameProblem(
        attachment,
        MarkerTerm(observed, sigma, config.reach),
        PosePrior(attachment, prior, shape_sigma),
        missing_factor(observed, prior_config.missing),
    )


def velocity_term(attachment: Attachment, rate: float, config: StageTwoConfig) -> Velocity:
    """What joins frames; spreads grow with the time between them."""
    turn = torch.where(attachment.joints >= _FINGERS, config.finger_turn, config.turn).repeat_interleave(3)
    sigma = torch.cat([turn.new_full((3,), config.shift), turn, turn.new_full((attachment.n_shapes,), 0.1)])
    return Velocity(((sigma * 120 / rate) ** -2).to(attachment.dtype), attachment.joints)


def _first_poses(
    problem: FrameProblem,
    prior: JointPrior,
    trunk: Tensor,
    rate: float,
    config: StageTwoConfig,
    progress: Callable[[float], None],
) -> Pose:
    """Poses of all frames, from those of a few."""
    observed, reach, problem = problem.markers.observed, problem.markers.reach, problem.reaching(_REACH)
    t, seen = len(observed), observed[..., 0].isfinite()
    rough = _best_seen(seen, trunk, max(1, round(_ROUGH * rate)))
    pose, cost = start(problem.frames(rough), prior, trunk)
    good = ~_failed(cost, seen[rough])
    rough, pose = rough[good], pose.frames(good)
    every = max(1, round(_FINE * rate))
    fine = torch.arange(0, t, every, device=observed.device)
    pose, _ = solve_frames(problem.frames(fine), between(pose, rough, fine), 8, progress=progress)
    pose = _second_opinion(problem.frames(fine).reaching(reach), fine, pose)
    good = (seen[fine].sum(1) >= 3) & pose.transl.isfinite().all(1)
    good = good if good.any() else torch.ones_like(good)
    pose, fine = pose.frames(good), fine[good]
    if len(fine) > 1:
        # A hidden joint has fallen to its usual turn: what lies before and after says better where it is.
        velocity = velocity_term(problem.attachment, rate / every, config)
        damping = torch.full((len(fine),), 1e-4, dtype=torch.float64, device=fine.device)
        for number in range(2):
            windows = Windows(config.window, config.windows)
            pose = sweep(problem.frames(fine).reaching(reach), velocity, pose, damping, windows, number)
    return between(pose, fine, torch.arange(t, device=fine.device))


def _second_opinion(problem: FrameProblem, frames: Tensor, pose: Pose) -> Pose:
    """Solve frames that differ much from the next, or cost more than usual, from what lies between those that don't.

    A wrong label can flip a foot: seen from its neighbours' pose the marker is an outlier.
    """
    cost = problem.cost(pose)
    turned = log(pose.rotations[:-1].mT @ pose.rotations[1:]).norm(dim=-1).amax(1) > _TURNED
    doubtful = ~(cost < _DOUBTFUL * cost.nanmedian())
    doubtful[1:] |= turned
    doubtful[:-1] |= turned
    if not doubtful.any() or doubtful.all():
        return pose
    beside = between(pose.frames(~doubtful), frames[~doubtful], frames[doubtful])
    other, better = solve_frames(problem.frames(doubtful), beside, 8)
    better = ~(better >= cost[doubtful])
    pose.put(doubtful.nonzero().squeeze(1)[better], other.frames(better))
    return pose


def _best_seen(seen: Tensor, trunk: Tensor, every: int) -> Tensor:
    """Of each `every` frames the one that shows most; the trunk counts most."""
    worth = seen.float().mean(1) + 2 * (seen & trunk).float().mean(1)
    return torch.stack([s + worth[s : s + every].argmax() for s in range(0, len(seen), every)])


def _failed(cost: Tensor, seen: Tensor) -> Tensor:
    """(F,) frames that show too little, or whose cost says that the body lies otherwise than it should; never all."""
    each = torch.where(seen.sum(1) >= 3, cost / seen.sum(1).clamp_min(1), torch.inf).nan_to_num(torch.inf)
    return ~(each <= _FAILED * each.median().clamp_max(each.min() * 100)) & (each > each.min())


def between(pose: Pose, at: Tensor, asked: Tensor) -> Pose:
    """Poses at frames `asked` from those at frames `at` (ascending): evenly in between, held beyond."""
    after = torch.searchsorted(at, asked).clamp(max=len(at) - 1)
    before = torch.where(at[after] > asked, after - 1, after).clamp(min=0)
    share = ((asked - at[before]) / (at[after] - at[before]).clamp(min=1)).clamp(0, 1).to(pose.transl.dtype)
    return mixed(pose.frames(before), pose.frames(after), share)


def mixed(one: Pose, other: Pose, share: Tensor) -> Pose:
    """Poses on the way from one to the other, frame by frame; share (F,) is 0 at the one and 1 at the other."""
    turn = log(one.rotations.mT @ other.rotations) * share[:, None, None]
    mix = [a + share.unsqueeze(1) * (b - a) for a, b in ((one.transl, other.transl), (one.shape, other.shape))]
    return Pose(one.rotations @ exp(turn), *mix)
