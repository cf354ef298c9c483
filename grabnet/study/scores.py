"""Scores by condition and object, as in Table 2 of the paper, with intervals that raters and grasps are drawn for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from grabnet.evaluation.bootstrap import NOTHING, Estimate
from grabnet.study.answers import Answers
from grabnet.study.key import ALL, CATCH, EXAMPLE


@dataclass(frozen=True, eq=False)
class Ratings:
    """Ratings as arrays, catch trials apart.

    raters, objects, conditions: names.
    rater, grasp, object, condition: (N,) numbers of each rating's.
    rating: (N,) 1 … levels.
    levels: possible answers.
    """

    raters: list[str]
    objects: list[str]
    conditions: list[str]
    rater: np.ndarray
    grasp: np.ndarray
    object: np.ndarray
    condition: np.ndarray
    rating: np.ndarray
    levels: int

    @classmethod
    def of(cls, answers: Answers, conditions: Sequence[str], levels: int) -> Ratings:
        """The ratings of single videos in answers."""
        rows = [(row, answers.videos[row.videos[0]]) for row in answers.rows if len(row.videos) == 1]
        rows = [(row, shown) for row, shown in rows if shown.condition not in (CATCH, EXAMPLE)]
        raters = list(dict.fromkeys(row.rater for row, _ in rows))
        grasps = list(dict.fromkeys(row.videos[0] for row, _ in rows))
        objects = sorted({shown.object for _, shown in rows})
        used = [name for name in conditions if any(shown.condition == name for _, shown in rows)]

        def numbers(names: Sequence[str], values: Iterator[str]) -> np.ndarray:
            place = {name: k for k, name in enumerate(names)}
            return np.array([place[value] for value in values], np.int64)

        return cls(
            raters=raters,
            objects=objects,
            conditions=used,
            rater=numbers(raters, (row.rater for row, _ in rows)),
            grasp=numbers(grasps, (row.videos[0] for row, _ in rows)),
            object=numbers(objects, (shown.object for _, shown in rows)),
            condition=numbers(used, (shown.condition for _, shown in rows)),
            rating=np.array([row.answer for row, _ in rows], np.int64),
            levels=levels,
        )

    def __len__(self) -> int:
        return len(self.rating)


@dataclass(frozen=True, eq=False)
class Score:
    """Of one condition and object, or all objects.

    std: of the single ratings.
    mean: with the redrawings of raters and grasps.
    difference: of the mean from the first condition's.
    """

    condition: str
    object: str
    n: int
    std: float
    mean: Estimate
    difference: Estimate


def scores(ratings: Ratings, draws: int, seed: int) -> list[Score]:
    """Return means, deviations and differences by condition and object, and over all ratings.

    Raters are redrawn with replacement, and grasps within object and condition, both at once: the ratings of one rater
    are not independent of each other, nor are those of one grasp (Owen, Annals of Applied Statistics 2007).

    Args:
        ratings: of raters who count.
        draws: redrawings.
        seed: of these.
    """
    n_objects, n_conditions = len(ratings.objects), len(ratings.conditions)
    cell = ratings.condition * n_objects + ratings.object
    n_cells = n_objects * n_conditions
    rng = np.random.default_rng([seed, 7])
    cell_of_grasp = np.zeros(int(ratings.grasp.max(initial=-1)) + 1, np.int64)
    cell_of_grasp[ratings.grasp] = cell
    drawn = np.empty((draws, 2, n_cells))
    for k in range(draws):
        drawn[k] = _sums(ratings, cell, n_cells, _drawn_weights(ratings, cell_of_grasp, rng))
    whole = _sums(ratings, cell, n_cells, np.ones(len(ratings)))
    found = []
    for c, condition in enumerate(ratings.conditions):
        for o, name in [*enumerate(ratings.objects), (None, ALL)]:
            cells, first = (_cells(k, o, n_objects) for k in (c, 0))
            values = ratings.rating[np.isin(cell, np.arange(n_cells)[cells])]
            mean, reference = _estimate(whole, drawn, cells), _estimate(whole, drawn, first)
            difference = NOTHING
            if c and mean.n and reference.n:
                difference = Estimate(mean.value - reference.value, mean.drawn - reference.drawn, mean.n)
            std = float(values.std(ddof=1)) if len(values) > 1 else float("nan")
            found.append(Score(condition, name, len(values), std, mean, difference))
    return found


def _cells(condition: int, object_: int | None, n_objects: int) -> slice:
    start = condition * n_objects
    return slice(start, start + n_objects) if object_ is None else slice(start + object_, start + object_ + 1)


def _drawn_weights(ratings: Ratings, cell_of_grasp: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """How often each rating is in a redrawing."""
    n = len(ratings.raters)
    raters = np.bincount(rng.integers(n, size=n), minlength=n)
    grasps = np.zeros(len(cell_of_grasp))
    for cell in np.unique(cell_of_grasp):
        members = np.flatnonzero(cell_of_grasp == cell)
        grasps[members] = np.bincount(rng.integers(len(members), size=len(members)), minlength=len(members))
    return raters[ratings.rater] * grasps[ratings.grasp]


def _sums(ratings: Ratings, cell: np.ndarray, n: int, weights: np.ndarray) -> np.ndarray:
    """(2, cells): sums of ratings, and of weights."""
    return np.stack([np.bincount(cell, weights * ratings.rating, n), np.bincount(cell, weights, n)])


def _estimate(whole: np.ndarray, drawn: np.ndarray, cells: slice) -> Estimate:
    total, count = whole[:, cells].sum(1)
    if not count:
        return NOTHING
    sums = drawn[:, :, cells].sum(2)
    means = np.divide(sums[:, 0], sums[:, 1], out=np.full(len(sums), total / count), where=sums[:, 1] > 0)
    return Estimate(float(total / count), means, int(count))
