"""Analysis of a study: from files of answers to what is reported."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from grabnet.cli.checks import Seed, Several, in_range
from grabnet.errors import UserError
from grabnet.evaluation.bootstrap import Estimate
from grabnet.io.files import sha256
from grabnet.io.provenance import provenance
from grabnet.study.agreement import krippendorff_alpha
from grabnet.study.answers import Answers, read_answers
from grabnet.study.filtering import FilterConfig, Judged, judge
from grabnet.study.key import ANSWERS, CATCH, EXAMPLE, PRIVATE, StudyKey
from grabnet.study.ordinal import ModelConfig, OrdinalFit, fit
from grabnet.study.pairs import strengths
from grabnet.study.scores import Ratings, Score, scores
from grabnet.study.tables import BatchColumns, read_videos

_LEVELS = ("strongly disagree", "disagree", "neither agree nor disagree", "agree", "strongly agree")


@dataclass(frozen=True)
class AnalysisConfig:
    """The values of `configs/study/analyse.yaml`, which explains them.

    Raises:
        UserError: a value out of range.
    """

    answers: str | list[str] | None
    export: str | None
    videos: str | None
    reference: str | None
    output: str
    draws: Several
    seed: Seed
    filter: FilterConfig
    model: ModelConfig | None
    batch: BatchColumns
    quiet: bool = False  # for the command

    def __post_init__(self):
        in_range(self)
        if self.answers is None and self.export is None:
            raise UserError("Name what to analyse: export=<folder of a study>, or answers=<file>, or both.")

    @property
    def files(self) -> list[Path]:
        """Files and folders of answers."""
        if self.answers is None:
            return [Path(self.export or "").expanduser() / PRIVATE / ANSWERS]
        named = [self.answers] if isinstance(self.answers, str) else self.answers
        return [Path(name).expanduser() for name in named]


@dataclass(frozen=True, eq=False)
class Analysis:
    """What a study found.

    answers: all that are clear, and what was left out.
    judged: the raters.
    conditions: compared, that of the reference first.
    levels: words of the answers.
    ratings: of raters who count; without any in a paired study.
    scores: by condition and object; none in a paired study.
    alpha: of the ratings of shown grasps; NaN where there are none.
    alpha_catches: with catch trials.
    model: the ordinal model; None where it was not asked for, or could not be fitted.
    strengths: of a paired study, by condition.
    record: what it was made with.
    """

    answers: Answers
    judged: list[Judged]
    conditions: list[str]
    levels: list[str]
    ratings: Ratings
    scores: list[Score]
    alpha: float
    alpha_catches: float
    model: OrdinalFit | None
    strengths: dict[str, Estimate]
    record: dict[str, Any]

    @property
    def kept(self) -> list[str]:
        """Raters who count."""
        return [judged.rater for judged in self.judged if judged.is_kept]

    def score(self, condition: str, object_: str) -> Score:
        """The score of a condition and object, or of all."""
        return next(s for s in self.scores if (s.condition, s.object) == (condition, object_))


def analyse(config: AnalysisConfig) -> Analysis:
    """Read, filter and analyse answers.

    Raises:
        UserError: files that cannot be read, or no answer or rater left.
    """
    key = None if config.export is None else StudyKey.read(config.export)
    videos = dict(key.videos) if key else {}
    if config.videos is not None:
        videos |= read_videos(Path(config.videos).expanduser())
    levels = list(key.levels if key else _LEVELS)
    if config.filter.level > len(levels) and (key is None or key.kind == "rating"):
        raise UserError(f"filter.level is {config.filter.level}; the answers of this study are 1 to {len(levels)}.")
    answers = read_answers(config.files, key, videos, levels, config.batch)
    if not answers.rows:
        reasons = "; ".join(answers.problems[:3])
        named = ", ".join(map(str, config.files))
        raise UserError(f"No answer counts in {named}{': ' + reasons if reasons else ''}.")
    conditions = _conditions(answers, key, config.reference)
    judged = judge(answers, config.filter)
    kept = answers.of([j.rater for j in judged if j.is_kept])
    if not kept.rows:
        raise UserError(f"None of {len(judged)} raters is left: {judged[0].reason} (the first).")
    ratings = Ratings.of(kept, conditions, len(levels))
    is_rated = len(ratings) > 0
    model = None
    if is_rated and config.model is not None and len(ratings.conditions) > 1:
        model = fit(ratings, config.model, config.seed)
    files = {str(path): sha256(path) for path in config.files if path.is_file()}
    return Analysis(
        answers=answers,
        judged=judged,
        conditions=conditions,
        levels=levels,
        ratings=ratings,
        scores=scores(ratings, config.draws, config.seed) if is_rated else [],
        alpha=krippendorff_alpha(ratings.grasp, ratings.rating, len(levels)),
        alpha_catches=_alpha_of_all(kept, len(levels)),
        model=model,
        strengths=strengths(kept, conditions, config.draws, config.seed),
        record={
            "study": key.study if key else None,
            "answers_sha256": files,
            "config": asdict(config),
            "provenance": provenance(),
        },
    )


def _conditions(answers: Answers, key: StudyKey | None, reference: str | None) -> list[str]:
    """Conditions, the reference first: the one named, or the key's first, or one called like ground truth."""
    names = list(key.conditions) if key else []
    names += [name for name in answers.conditions if name not in (*names, EXAMPLE)]
    if reference is not None and reference not in names:
        raise UserError(f"reference={reference} is none of the conditions: {', '.join(names)}.")
    likely = [name for name in names if name.casefold().replace("_", " ") in ("ground truth", "gt")]
    first = reference or (names[0] if key or not likely else likely[0])
    return [first, *(name for name in names if name != first)]


def _alpha_of_all(answers: Answers, levels: int) -> float:
    rows = [row for row in answers.rows if len(row.videos) == 1 and _is_shown(answers, row.videos)]
    if not rows:
        return float("nan")
    return krippendorff_alpha(np.array([row.videos[0] for row in rows]), np.array([r.answer for r in rows]), levels)


def _is_shown(answers: Answers, videos: Sequence[str]) -> bool:
    return all(answers.videos[name].condition != EXAMPLE for name in videos)


def rating_shares(analysis: Analysis) -> dict[str, np.ndarray]:
    """Shares of the answers 1 … n, by condition, catch trials last, of raters who count."""
    kept, shares = analysis.answers.of(analysis.kept), {}
    for name in [*analysis.conditions, CATCH]:
        given = [r.answer for r in kept.rows if len(r.videos) == 1 and kept.videos[r.videos[0]].condition == name]
        if given:
            shares[name] = np.bincount(given, minlength=len(analysis.levels) + 1)[1:] / len(given)
    return shares
