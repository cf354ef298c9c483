"""Which trials each list of a study has: as many of each object and condition, each grasp as often as any other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from itertools import combinations
from typing import TypeVar

import numpy as np

from grabnet.study.key import CATCH, Shown

Item = TypeVar("Item")
Cell = tuple[Hashable, ...]


def balanced_lists(
    cells: Mapping[Cell, Sequence[Item]], shown: Mapping[Cell, int | None], n_lists: int, rng: np.random.Generator
) -> list[list[Item]]:
    """Return lists of trials in random order.

    Args:
        cells: trials of each cell, such as an object and condition.
        shown: trials of each cell in each list; None for all.
        n_lists: lists.
        rng: of the choices.

    Returns:
        n_lists lists. Over all, trials of one cell are in equally many lists, or in one more.
    """
    lists: list[list[Item]] = [[] for _ in range(n_lists)]
    for cell, trials in cells.items():
        used: Counter[int] = Counter()
        most = len(trials) if shown[cell] is None else min(shown[cell], len(trials))
        for chosen in lists:
            tie = rng.permutation(len(trials))
            rarest = sorted(range(len(trials)), key=lambda i, tie=tie: (used[i], tie[i]))[:most]
            used.update(rarest)
            chosen += [trials[i] for i in rarest]
    return [[chosen[i] for i in rng.permutation(len(chosen))] for chosen in lists]


def rating_cells(videos: Mapping[str, Shown]) -> dict[Cell, list[list[str]]]:
    """Trials of one video each, by object and condition."""
    cells: dict[Cell, list[list[str]]] = {}
    for name, shown in videos.items():
        cells.setdefault((shown.object, shown.condition), []).append([name])
    return cells


def paired_cells(
    videos: Mapping[str, Shown], conditions: Sequence[str], rng: np.random.Generator
) -> dict[Cell, list[list[str]]]:
    """Trials of two videos of one object, by object and the two conditions; catch trials beside the first condition.

    Each grasp is in one trial at most of each pair of conditions.
    """
    singles = rating_cells(videos)
    cells: dict[Cell, list[list[str]]] = {}
    for name in dict.fromkeys(shown.object for shown in videos.values()):
        for first, second in [*combinations(conditions, 2), (conditions[0], CATCH)]:
            left, right = singles.get((name, first), []), singles.get((name, second), [])
            n = min(len(left), len(right))
            pairs = zip(rng.permutation(len(left))[:n], rng.permutation(len(right))[:n], strict=True)
            cells[name, first, second] = [left[i] + right[j] for i, j in pairs]
    return cells
