"""Timing several ways of doing one thing against each other, on machines that are seldom quiet."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Case:
    """One thing to time.

    run: does it once. baseline: name of the case it is compared with, which does the same in a plainer way.
    """

    name: str
    run: Callable[[], object]
    baseline: str | None = None


@dataclass(frozen=True)
class Timing:
    """Seconds per run: median, and the quartiles as spread. speedup: median of baseline / case, run beside run."""

    name: str
    runs: int
    median: float
    lower: float
    upper: float
    baseline: str | None
    speedup: float | None


def measure(cases: Sequence[Case], runs: int) -> list[Timing]:
    """Time every case `runs` times (at least 2) after a first run that does not count.

    The cases take turns, so that what else the machine does weighs on all of them alike.
    """
    seconds: dict[str, list[float]] = {case.name: [] for case in cases}
    for turn in range(runs + 1):
        for case in cases:
            start = time.perf_counter()
            case.run()
            if torch.cuda.is_available():
                torch.cuda.synchronize()
            if turn:
                seconds[case.name].append(time.perf_counter() - start)
    return [_timing(case, seconds) for case in cases]


def _timing(case: Case, seconds: dict[str, list[float]]) -> Timing:
    own = seconds[case.name]
    lower, median, upper = statistics.quantiles(own, n=4, method="inclusive")
    speedup = None
    if case.baseline is not None:
        speedup = statistics.median(b / a for a, b in zip(own, seconds[case.baseline], strict=True))
    return Timing(case.name, len(own), median, lower, upper, case.baseline, speedup)
