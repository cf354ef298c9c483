"""Timing several ways of doing one thing against each other, on machines that are seldom quiet."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch

from grabnet.cli.progress import track


@dataclass(frozen=True)
class Case:
    """One thing to time.

    run: does it once. baselines: names of the cases it is compared with, which do the same in a plainer way, or a
    part of it. runs: at most so many, for what takes long. frames: that one run works on, to tell a rate; the ratio of
    cases that both have them is that of their times per frame.
    """

    name: str
    run: Callable[[], object]
    baselines: tuple[str, ...] = ()
    runs: int | None = None
    frames: int | None = None


@dataclass(frozen=True)
class Timing:
    """Seconds per run: median, and the quartiles as spread. ratios: median of case / baseline, run beside run.

    frames_per_second: by the median; None where no frames are counted.
    """

    name: str
    runs: int
    median: float
    lower: float
    upper: float
    ratios: dict[str, float]
    frames_per_second: float | None


def measure(cases: Sequence[Case], runs: int) -> list[Timing]:
    """Time every case `runs` times (at least 2) after a first run that does not count.

    The cases take turns, so that what else the machine does weighs on all of them alike.
    """
    seconds: dict[str, list[float]] = {case.name: [] for case in cases}
    for turn in track(range(runs + 1), "Timing rounds"):
        for case in cases:
            if case.runs is not None and turn > case.runs:
                continue
            start = time.perf_counter()
            case.run()
            if torch.cuda.is_available():
                torch.cuda.synchronize()
            if turn:
                seconds[case.name].append(time.perf_counter() - start)
    frames = {case.name: case.frames for case in cases}
    return [_timing(case, seconds, frames) for case in cases]


def _timing(case: Case, seconds: dict[str, list[float]], frames: dict[str, int | None]) -> Timing:
    own = seconds[case.name]
    lower, median, upper = statistics.quantiles(own, n=4, method="inclusive")
    ratios = {}
    for name in case.baselines:
        of_frames = frames[name] / case.frames if case.frames and frames[name] else 1
        # Of runs in the same turn; one of the two may have taken part in fewer.
        ratios[name] = of_frames * statistics.median(a / b for a, b in zip(own, seconds[name], strict=False))
    rate = None if case.frames is None else case.frames / median
    return Timing(case.name, len(own), median, lower, upper, ratios, rate)
