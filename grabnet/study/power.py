"""How many raters and grasps a difference of mean answers needs to be found.

Raters and grasps are both drawn from many, and crossed, so that the variance of a difference has a part that only more
grasps make smaller, one that only more raters do, and a rest (Westfall, Kenny and Judd, Journal of Experimental
Psychology: General 2014).
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm

from grabnet.cli.checks import Count, Filled, Range, in_range
from grabnet.errors import UserError
from grabnet.io.files import write_json
from grabnet.io.provenance import provenance
from grabnet.study.raters import RaterModel

Counts = Annotated[list[Count], Filled()]
Probability = Annotated[float, Range(1e-6, 1 - 1e-6)]


@dataclass(frozen=True)
class PowerConfig:
    """The values of `configs/study/power.yaml`, which explains them.

    Raises:
        UserError: a value out of range.
    """

    difference: float
    raters: Counts
    grasps: Counts
    objects: Count
    shown: Count
    level: Probability
    power: Probability
    model: RaterModel
    output: str | None
    quiet: bool = False  # for the command

    def __post_init__(self):
        in_range(self)
        if not self.difference:
            raise UserError("difference is 0; no number of raters finds it.")


@dataclass(frozen=True)
class Components:
    """Variances of a difference of two conditions' mean answers, each for one unit.

    grasp: for one grasp of each condition. rater: for one rater of both. rest: for one answer to each condition.
    """

    grasp: float
    rater: float
    rest: float

    def error(self, raters: int, grasps: int, answers: int) -> float:
        """Standard error of the difference.

        Args:
            raters: who count.
            grasps: of each condition.
            answers: of one rater to each condition.
        """
        return math.sqrt(self.grasp / grasps + self.rater / raters + self.rest / (raters * answers))


def components(model: RaterModel) -> Components:
    """The variances that the rater model implies on the scale of the answers, by quadrature."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(24)
    weights = weights / weights.sum()
    grasp, rater, rest, by_bias = 0.0, 0.0, 0.0, []
    levels = np.arange(model.levels)
    for condition in (0, 1):
        # Axes: grasp, rater, own view.
        eta = model.mean_of(condition) + sum(
            np.ix_(model.grasp * nodes, model.rater * nodes, model.own * nodes)
        )  # fmt: skip
        mean = model.expected(eta)
        exceeds = 1 / (1 + np.exp(-(eta[..., None] - np.asarray(model.thresholds))))
        square = 1 + ((2 * levels[1:] + 1) * exceeds).sum(-1)  # E[y²] by levels exceeded
        of_grasp = mean @ weights @ weights
        of_view = np.einsum("g,grv->rv", weights, mean)
        overall = float(weights @ of_grasp)
        total = float(np.einsum("g,r,v,grv->", weights, weights, weights, square)) - overall**2
        var_grasp = float(weights @ of_grasp**2) - overall**2
        var_view = float(np.einsum("r,v,rv->", weights, weights, of_view**2)) - overall**2
        grasp, rater, rest = grasp + var_grasp, rater + var_view, rest + total - var_grasp - var_view
        by_bias.append(of_view @ weights)
    shared = float(weights @ (by_bias[0] * by_bias[1]) - (weights @ by_bias[0]) * (weights @ by_bias[1]))
    return Components(grasp, rater - 2 * shared, rest)


def planted(model: RaterModel, difference: float) -> RaterModel:
    """The model in which the second condition's mean answer differs from the first's by `difference`.

    Raises:
        UserError: answers have no room for it.
    """

    def off(eta: float) -> float:
        moved = replace(model, difference=eta)
        return moved.mean_answer(1) - moved.mean_answer(0) - difference

    try:
        return replace(model, difference=float(brentq(off, -30, 30)))
    except ValueError:
        room = model.mean_answer(0)
        raise UserError(
            f"difference is {difference}; with the first condition at {room:.2f} of 1 to {model.levels} there is no "
            "room for it."
        ) from None


def power(difference: float, error: float, level: float) -> float:
    """The probability that a test of this level finds a difference of this standard error."""
    limit, size = norm.ppf(1 - level / 2), abs(difference) / error
    return float(norm.cdf(size - limit) + norm.cdf(-size - limit))


def raters_needed(parts: Components, config: PowerConfig, grasps: int) -> float:
    """Raters for the power that the config asks for, with so many grasps per object; infinite where none suffice."""
    target = (config.difference / (norm.ppf(1 - config.level / 2) + norm.ppf(config.power))) ** 2
    left = target - parts.grasp / (config.objects * grasps)
    answers = config.objects * min(config.shown, grasps)
    return (parts.rater + parts.rest / answers) / left if left > 0 else math.inf


def run(config: PowerConfig) -> int:
    """Print the power of each number of raters and grasps, and how many raters each number of grasps needs.

    Returns:
        the exit code.
    """
    model = planted(config.model, config.difference)
    parts = components(model)
    table = [
        [power(config.difference, _error(parts, config, r, g), config.level) for r in config.raters]
        for g in config.grasps
    ]
    needed = [raters_needed(parts, config, g) for g in config.grasps]
    print(f"Power to find a difference of {config.difference:+g} in the mean answer, at the level {config.level:g};")
    print(
        f"{config.objects} objects, {config.shown} grasps of each object and condition shown to each rater who counts."
    )
    print(
        "grasps per object | " + " ".join(f"{r:>6} raters" for r in config.raters) + f" | raters for {config.power:g}"
    )
    for g, row, least in zip(config.grasps, table, needed, strict=True):
        print(f"{g:>17} | " + " ".join(f"{value:>13.2f}" for value in row) + f" | {_whole(least)}")
    if config.output is not None:
        facts = {"components": asdict(parts), "power": table, "raters_needed": [_finite(n) for n in needed]}
        path = Path(config.output).expanduser()
        write_json(path, facts | {"config": asdict(config), "provenance": provenance()})
        print(f"{path} has these numbers")
    return 0


def _error(parts: Components, config: PowerConfig, raters: int, grasps: int) -> float:
    return parts.error(raters, config.objects * grasps, config.objects * min(config.shown, grasps))


def _whole(n: float) -> str:
    return f"{math.ceil(n):>14}" if math.isfinite(n) else "no number of them"


def _finite(n: float) -> int | None:
    return math.ceil(n) if math.isfinite(n) else None
