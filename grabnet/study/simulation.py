"""A study rehearsed with synthetic raters: does the filter find the careless, and the analysis what was planted?"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from grabnet.cli.checks import Amount, Count, Seed, Several, Share, in_range, one_of
from grabnet.cli.progress import track
from grabnet.errors import UserError
from grabnet.io.files import write_bytes, write_json
from grabnet.io.provenance import provenance
from grabnet.study.answers import Answers
from grabnet.study.filtering import FilterConfig, judge
from grabnet.study.key import ALL, ANSWERS, CATCH, KINDS, PRIVATE, SECRET, Shown, StudyKey
from grabnet.study.ordinal import ModelConfig, fit
from grabnet.study.raters import RaterModel, simulated_answers
from grabnet.study.scores import Ratings, scores
from grabnet.study.trials import balanced_lists, paired_cells, rating_cells

_RECORD = "simulation.json"


@dataclass(frozen=True)
class DesignConfig:
    """A study without videos: how many there would be of what; the values of `export.yaml` of these names."""

    kind: str
    objects: Count
    n: Count
    catches: Amount
    shown: Count | None
    catches_shown: Amount | None
    lists: Count

    def __post_init__(self):
        in_range(self, "design.")
        one_of(self, "design.", kind=KINDS)

    def key(self, levels: int, rng: np.random.Generator) -> StudyKey:
        """The key of such a study, of two conditions."""
        conditions, videos = ["Ground truth", "generated"], {}
        for o in range(self.objects):
            for condition in (*conditions, CATCH):
                for k in range(self.catches if condition == CATCH else self.n):
                    videos[f"{len(videos):020x}"] = Shown(f"object{o + 1}", condition, k)
        cells = rating_cells(videos) if self.kind == "rating" else paired_cells(videos, conditions, rng)
        shown = {cell: self.catches_shown if cell[-1] == CATCH else self.shown for cell in cells}
        lists = balanced_lists(cells, shown, self.lists, rng)
        names = [str(k + 1) for k in range(levels)] if self.kind == "rating" else ["left", "right"]
        return StudyKey("0" * 16, self.kind, names, conditions, videos, lists, {"design": asdict(self)})


@dataclass(frozen=True)
class SimulationConfig:
    """The values of `configs/study/simulate.yaml`, which explains them.

    Raises:
        UserError: a value out of range.
    """

    export: str | None
    design: DesignConfig
    raters: Several
    careless: Share
    model: RaterModel
    repeats: Count
    fits: Amount
    draws: Several
    seed: Seed
    output: str
    filter: FilterConfig
    chains: ModelConfig
    quiet: bool = False  # for the command

    def __post_init__(self):
        in_range(self)
        if self.fits > self.repeats:
            raise UserError(f"fits is {self.fits}; it can be repeats, {self.repeats}, at most.")


def run(config: SimulationConfig) -> int:
    """Simulate studies, print what was found, and write the first one's answers as a server would have stored them.

    Returns:
        the exit code.
    """
    output = Path(config.output).expanduser()
    rng = np.random.default_rng([config.seed, 9])
    own = config.export is None
    _refuse_real_answers(output)
    key = config.design.key(config.model.levels, rng) if own else StudyKey.read(config.export)
    if key.kind == "rating" and len(key.levels) != config.model.levels:
        raise UserError(f"The study has {len(key.levels)} levels; model.thresholds must be one fewer.")
    record, found = {"config": asdict(config), "provenance": provenance()}, []
    write_json(output / _RECORD, record)  # first, so that answers of a stopped simulation are known for what they are
    for repeat in track(range(config.repeats), "Simulating studies"):
        answers, careless = simulated_answers(key, config.model, config.raters, config.careless, rng)
        found.append(_rehearse(key, answers, careless, config, repeat))
        if not repeat:
            _write_answers(output, key, answers, own)
    summary = _summary(found, config)
    write_json(output / _RECORD, summary | record)
    print(json.dumps(summary, indent=2))
    where = output if own else config.export
    more = "" if own else f" answers={output / ANSWERS}"
    print(f"grabnet study analyse export={where}{more} reports the first simulated study")
    return 0


def _refuse_real_answers(output: Path) -> None:
    """Raise a `UserError` where synthetic answers would replace an export's key, or answers of people."""
    for folder in (output / PRIVATE, output):
        is_simulated = (output / _RECORD).exists()
        if (folder / SECRET).exists() or ((folder / ANSWERS).exists() and not is_simulated):
            raise UserError(f"{folder} holds a study or answers that no simulation wrote: choose another output.")


def _rehearse(
    key: StudyKey, answers: Answers, careless: set[str], config: SimulationConfig, repeat: int
) -> dict[str, Any]:
    judged = judge(answers, config.filter)
    dropped = {j.rater for j in judged if not j.is_kept}
    found: dict[str, Any] = {"dropped": len(dropped), "careless": len(careless), "both": len(dropped & careless)}
    kept = answers.of([j.rater for j in judged if j.is_kept])
    if key.kind == "rating" and len(key.conditions) > 1 and kept.rows:
        ratings = Ratings.of(kept, key.conditions, len(key.levels))
        # All conditions but the first differ from it by the same: the second is looked at.
        score = next(s for s in scores(ratings, config.draws, config.seed + repeat)
                     if (s.condition, s.object) == (key.conditions[1], ALL))  # fmt: skip
        found["difference"] = (score.difference.value, *score.difference.interval)
        if repeat < config.fits:
            log_odds = fit(ratings, config.chains, config.seed + repeat).differences[key.conditions[1], None]
            found["log_odds"] = (log_odds.value, *log_odds.interval)
    return found


def _summary(found: list[dict[str, Any]], config: SimulationConfig) -> dict[str, Any]:
    total = {name: sum(f[name] for f in found) for name in ("dropped", "careless", "both")}
    summary: dict[str, Any] = {
        "studies": len(found),
        "raters": config.raters,
        "filter": {
            "precision": total["both"] / total["dropped"] if total["dropped"] else None,
            "recall": total["both"] / total["careless"] if total["careless"] else None,
            "dropped_per_study": total["dropped"] / len(found),
        },
    }
    planted = {
        "difference": config.model.mean_answer(1) - config.model.mean_answer(0),
        "log_odds": config.model.difference,
    }
    for name, value in planted.items():
        intervals = np.array([f[name] for f in found if name in f])
        if len(intervals):
            estimate, low, high = intervals.T
            summary[name] = {
                "planted": value,
                "mean_estimate": float(estimate.mean()),
                "deviation_of_estimates": float(estimate.std(ddof=1)) if len(estimate) > 1 else None,
                "mean_interval": [float(low.mean()), float(high.mean())],
                "in_interval": float(((low <= value) & (value <= high)).mean()),
                "detected": float(((low > 0) | (high < 0)).mean()),
                "studies": len(intervals),
            }
    return summary


def _write_answers(output: Path, key: StudyKey, answers: Answers, with_key: bool) -> None:
    if with_key:
        key.write(output)
    lists = {}
    for rater, rows in groupby(answers.rows, key=lambda row: row.rater):
        given = list(rows)
        lists[rater] = {
            "study": key.study,
            "session": rater,
            "list": int(rater, 16) % len(key.lists),
            "platform": {},
            "answers": [{"videos": list(r.videos), "answer": r.answer, "seconds": r.seconds} for r in given],
        }
    lines = "".join(json.dumps(record, separators=(",", ":"), sort_keys=True) + "\n" for record in lists.values())
    write_bytes(output / PRIVATE / ANSWERS if with_key else output / ANSWERS, lines.encode())
