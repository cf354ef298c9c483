"""Which raters count: those that know an implausible grasp when they see one (paper S.9.4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from grabnet.cli.checks import Amount, Range, in_range
from grabnet.study.answers import Answers
from grabnet.study.key import CATCH


@dataclass(frozen=True)
class FilterConfig:
    """When a rater is left out.

    level: a catch trial rated so, or better, was taken for plausible.
    share: of a rater's catch trials; with so many or more taken for plausible the rater is left out.
    least: catch trials that a rater must have answered to be judged.

    Raises:
        UserError: a value out of range.
    """

    level: Annotated[int, Range(2, 9)]
    share: Annotated[float, Range(0, 1, above=True)]
    least: Amount

    def __post_init__(self):
        in_range(self, "filter.")


@dataclass(frozen=True)
class Judged:
    """A rater, judged by catch trials.

    rater: who.
    answers: given in all.
    catches: catch trials answered.
    missed: of these, taken for plausible.
    reason: why the rater is left out; empty where not.
    """

    rater: str
    answers: int
    catches: int
    missed: int
    reason: str

    @property
    def is_kept(self) -> bool:
        """Whether the rater counts."""
        return not self.reason


def judge(answers: Answers, config: FilterConfig) -> list[Judged]:
    """Judge each rater. Of a pair with a catch trial, choosing that is to take it for plausible."""
    counts = {rater: [0, 0, 0] for rater in answers.raters}
    for row in answers.rows:
        count = counts[row.rater]
        count[0] += 1
        if not answers.is_catch(row):
            continue
        count[1] += 1
        if len(row.videos) > 1:
            count[2] += answers.videos[row.videos[row.answer - 1]].condition == CATCH
        else:
            count[2] += row.answer >= config.level
    return [Judged(rater, *count, _reason(*count[1:], config)) for rater, count in counts.items()]


def _reason(catches: int, missed: int, config: FilterConfig) -> str:
    if catches < config.least:
        return f"answered {catches} catch trials, not {config.least}"
    if catches and missed >= config.share * catches - 1e-12:
        return f"took {missed} of {catches} catch trials for plausible"
    return ""
