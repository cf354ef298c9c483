"""Paired comparisons: the strength of each condition by the model of Bradley and Terry."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from grabnet.evaluation.bootstrap import Estimate
from grabnet.study.answers import Answers
from grabnet.study.key import CATCH

_STEPS = 200


def bradley_terry(wins: np.ndarray) -> np.ndarray:
    """Return log strengths (…, n), the first 0: i is chosen before j with the odds exp(strength i − strength j).

    By Hunter's minorise-maximise steps (Annals of Statistics 2004), which solve many tables
    at once, as redrawings need.

    Args:
        wins: (…, n, n) how often i was chosen before j; above 0 where they were compared.
    """
    shown = wins + wins.swapaxes(-1, -2)
    won, strength = wins.sum(-1), np.ones(wins.shape[:-1])
    for _ in range(_STEPS):
        pairs = shown / (strength[..., :, None] + strength[..., None, :])
        strength = won / pairs.sum(-1)
        strength = strength / np.exp(np.log(strength).mean(-1, keepdims=True))
    strength = np.log(strength)
    return strength - strength[..., :1]


def strengths(answers: Answers, conditions: Sequence[str], draws: int, seed: int) -> dict[str, Estimate]:
    """Return each compared condition's log strength against the first, raters and grasps redrawn.

    Half a choice each way is added to every pair of conditions, so that strengths stay finite.

    Args:
        answers: of raters who count.
        conditions: those compared.
        draws: redrawings.
        seed: of these.
    """
    compared = {answers.videos[name].condition for row in answers.rows if len(row.videos) == 2 for name in row.videos}
    place = {name: k for k, name in enumerate(name for name in conditions if name in compared)}
    rows = []
    for row in answers.rows:
        if len(row.videos) == 2:
            chosen, other = row.videos[row.answer - 1], row.videos[2 - row.answer]
            pair = (answers.videos[chosen].condition, answers.videos[other].condition)
            if CATCH not in pair and set(pair) <= place.keys():
                rows.append((row.rater, frozenset(row.videos), place[pair[0]], place[pair[1]]))
    if not rows:
        return {}
    _, rater = np.unique([row[0] for row in rows], return_inverse=True)
    trials = {trial: k for k, trial in enumerate(dict.fromkeys(row[1] for row in rows))}
    trial = np.array([trials[row[1]] for row in rows])
    n = len(place)
    cell = np.array([row[2] * n + row[3] for row in rows])
    rng = np.random.default_rng([seed, 8])

    def table(weights: np.ndarray) -> np.ndarray:
        return np.bincount(cell, weights, n * n).reshape(n, n)

    def weights() -> np.ndarray:
        raters, grasps = rater.max() + 1, len(trials)
        drawn = np.bincount(rng.integers(raters, size=raters), minlength=raters)[rater]
        return drawn * np.bincount(rng.integers(grasps, size=grasps), minlength=grasps)[trial]

    whole = table(np.ones(len(rows)))
    half = 0.5 * (whole + whole.T > 0)
    value = bradley_terry(whole + half)
    drawn = bradley_terry(np.stack([table(weights()) + half for _ in range(draws)]))
    return {name: Estimate(float(value[k]), drawn[:, k], len(rows)) for name, k in place.items()}
