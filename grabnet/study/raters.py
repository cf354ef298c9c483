"""Synthetic raters with known tendencies, and the answers that they give.

A rater agrees with a grasp by η = condition + grasp + rater + (rater's own view of the condition) + noise, and answers
with the level whose thresholds η lies between. Careless raters answer without looking.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from grabnet.cli.checks import Filled, Weight, in_range
from grabnet.errors import UserError
from grabnet.study.answers import Answer, Answers
from grabnet.study.key import CATCH, EXAMPLE, StudyKey

CARELESS = ("random", "yes", "middle")


@dataclass(frozen=True)
class RaterModel:
    """What raters answer; all but `careless` on the scale of η, whose noise has the logistic distribution.

    thresholds: between the levels, ascending.
    reference: mean η of the first condition.
    difference: of every other condition's mean η from it.
    catch: mean η of catch trials.
    grasp: standard deviation of grasps of one condition and object.
    rater: standard deviation of raters.
    own: standard deviation of raters' own views of a condition.

    Raises:
        UserError: a value out of range.
    """

    thresholds: Annotated[list[float], Filled()]
    reference: float
    difference: float
    catch: float
    grasp: Weight
    rater: Weight
    own: Weight

    def __post_init__(self):
        in_range(self, "model.")
        if list(self.thresholds) != sorted(set(self.thresholds)):
            raise UserError(f"model.thresholds is {list(self.thresholds)}; it must ascend.")

    @property
    def levels(self) -> int:
        """Possible answers."""
        return len(self.thresholds) + 1

    def mean_of(self, condition: int) -> float:
        """Mean η of a condition by its number; -1 for catch trials."""
        return self.catch if condition < 0 else self.reference + (self.difference if condition else 0.0)

    def expected(self, eta: np.ndarray) -> np.ndarray:
        """The mean answer at η, over the noise."""
        steps = np.asarray(eta, float)[..., None] - np.asarray(self.thresholds, float)
        return 1 + (1 / (1 + np.exp(-steps))).sum(-1)

    def answer(self, eta: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Answers 1 … levels."""
        noisy = np.asarray(eta, float) + rng.logistic(size=np.shape(eta))
        return 1 + np.searchsorted(np.asarray(self.thresholds, float), noisy)

    def mean_answer(self, condition: int) -> float:
        """The mean answer over all raters and grasps that there could be, by quadrature."""
        spread = math.sqrt(self.grasp**2 + self.rater**2 + self.own**2)
        nodes, weights = np.polynomial.hermite_e.hermegauss(60)
        return float(self.expected(self.mean_of(condition) + spread * nodes) @ weights / weights.sum())


def simulated_answers(
    key: StudyKey, model: RaterModel, raters: int, careless: float, rng: np.random.Generator
) -> tuple[Answers, set[str]]:
    """Answers of synthetic raters to the lists of a study, in turn, and which raters are careless.

    Careless raters are in turn of three kinds: any answer at random, always one of the best two, always the middle.

    Args:
        key: of the study.
        model: of the others.
        raters: in all.
        careless: share of them.
        rng: of everything.
    """
    number = {name: k for k, name in enumerate(key.conditions)} | {CATCH: -1}
    grasp = {
        name: model.mean_of(number[shown.condition]) + rng.normal(0, model.grasp) * (shown.condition != CATCH)
        for name, shown in key.videos.items()
        if shown.condition != EXAMPLE
    }
    chosen = rng.permutation(raters)[: round(careless * raters)]
    kinds = {int(r): CARELESS[k % len(CARELESS)] for k, r in enumerate(chosen)}
    rows: list[Answer] = []
    for r in range(raters):
        bias = rng.normal(0, model.rater)
        own = {name: bias + rng.normal(0, model.own) for name in number}
        trials = key.lists[r % len(key.lists)]
        for trial in (trials[i] for i in rng.permutation(len(trials))):
            videos = tuple(trial[i] for i in rng.permutation(len(trial)))
            eta = [grasp[name] + own[key.videos[name].condition] for name in videos]
            rows.append(Answer(session(r), videos, _answer(eta, kinds.get(r, ""), model, rng), seconds=5.0))
    return Answers(rows, dict(key.videos), []), {session(r) for r in kinds}


def session(rater: int) -> str:
    """What stands for a synthetic rater in answers."""
    return f"{rater:032x}"


def _answer(eta: Sequence[float], kind: str, model: RaterModel, rng: np.random.Generator) -> int:
    levels = 2 if len(eta) > 1 else model.levels
    match kind:
        case "random":
            return int(rng.integers(1, levels + 1))
        case "yes":
            return int(rng.integers(max(1, levels - 1), levels + 1))
        case "middle":
            return (levels + 1) // 2
    if len(eta) > 1:
        return 1 if eta[0] + rng.logistic() > eta[1] else 2
    return int(model.answer(np.array(eta[0]), rng))
