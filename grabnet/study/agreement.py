"""Agreement of raters: Krippendorff's alpha for ordinal ratings."""

from __future__ import annotations

import numpy as np


def krippendorff_alpha(unit: np.ndarray, rating: np.ndarray, levels: int) -> float:
    """Return alpha: 1 where raters agree on every unit, 0 where they agree as by chance.

    By Krippendorff, "Computing Krippendorff's alpha-reliability" (2011), with its ordinal differences; missing ratings
    are allowed. (The package of that name is under the GPL, and so no part of this project.)

    Args:
        unit: (N,) what each rating is of; raters differ within a unit.
        rating: (N,) 1 … levels.
        levels: possible ratings.

    Returns:
        NaN where fewer than two ratings of one unit, or no two levels, are there.
    """
    _, unit = np.unique(unit, return_inverse=True)
    counts = np.zeros((int(unit.max(initial=-1)) + 1, levels))
    np.add.at(counts, (unit, rating - 1), 1)
    counts = counts[counts.sum(1) > 1]
    per_unit = counts.sum(1, keepdims=True)
    together = (counts / (per_unit - 1)).T @ counts - np.diag((counts / (per_unit - 1)).sum(0))
    used = together.sum(0)
    below = np.cumsum(used) - used / 2
    differences = (below[:, None] - below) ** 2
    n = used.sum()
    expected = (np.outer(used, used) * differences).sum()
    return float(1 - (n - 1) * (together * differences).sum() / expected) if n and expected else float("nan")
