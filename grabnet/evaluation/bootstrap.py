"""Intervals: how far a mean could be off, had other grasps been drawn.

These are the percentile intervals of `scipy.stats.bootstrap`, which is not used because it refuses objects with a
single grasp, and cannot take out the bias that redrawing brings into some statistics.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

LEVEL = 0.95


@dataclass(frozen=True, eq=False)
class Estimate:
    """A number, and its value in redrawings, with replacement, of the same grasps.

    Attributes:
        value: NaN where nothing could be measured.
        drawn: (B,) of the redrawings.
        n: grasps that count.
    """

    value: float
    drawn: np.ndarray
    n: int

    @property
    def interval(self) -> tuple[float, float]:
        """Bounds of the middle 95 % of the redrawings."""
        if not len(self.drawn):
            return float("nan"), float("nan")
        low, high = np.quantile(self.drawn, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
        return float(low), float(high)

    def above(self, other: Estimate) -> bool:
        """Whether this number is larger than the other by more than chance: so in 97.5 % of redrawings of both."""
        if not (len(self.drawn) and len(other.drawn) and self.value > other.value):
            return False
        # Both were redrawn by one seed: draw k of both takes the same grasps' numbers. Reversed, they are independent.
        return float(np.quantile(self.drawn - other.drawn[::-1], (1 - LEVEL) / 2)) > 0


NOTHING = Estimate(float("nan"), np.empty(0), 0)


def mean(groups: Sequence[np.ndarray], draws: int, seed: int) -> Estimate:
    """Return the mean over groups (objects) of the means of their values, grasps redrawn within each group.

    Args:
        groups: (N,) each. NaN, what could not be measured, does not count; nor does a group of nothing else.
        draws: redrawings.
        seed: of these.
    """
    groups = [known for values in groups if len(known := values[np.isfinite(values)])]
    if not groups:
        return NOTHING
    rng = np.random.default_rng(seed)
    drawn = np.zeros(draws)
    for values in groups:
        drawn += values[rng.integers(len(values), size=(draws, len(values)))].mean(1)
    value = float(np.mean([values.mean() for values in groups]))
    return Estimate(value, drawn / len(groups), sum(map(len, groups)))


def statistic(n: int, of: Callable[[np.ndarray], float], draws: int, seed: int) -> Estimate:
    """Return a statistic of n grasps.

    The redrawings are moved to have the value as their mean: many functions, such as an entropy, are biased when some
    grasps are taken twice and others not at all.

    Args:
        n: grasps.
        of: numbers of grasps, (n,) with repetitions → value.
        draws: redrawings.
        seed: of these.
    """
    rng = np.random.default_rng(seed)
    drawn = np.array([of(rng.integers(n, size=n)) for _ in range(draws)])
    value = of(np.arange(n))
    return Estimate(value, drawn + (value - drawn.mean()), n)
