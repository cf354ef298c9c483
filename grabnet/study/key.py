"""What a study's videos show: its key, which raters must not see, beside what the page reads.

An export is a folder of two: `site/`, which is served, and `private/`, which is not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from grabnet.errors import UserError
from grabnet.io.files import existing, write_json
from grabnet.io.state import read_json

SITE, PRIVATE, ANSWERS, SECRET = "site", "private", "answers.jsonl", "secret"
# Of catch trials, and of the videos in the instructions; no row of an evaluation is called so.
CATCH, EXAMPLE = "catch", "example"
# What reports call all objects together.
ALL = "all"
# Each trial shows one grasp, or two of which one is chosen.
KINDS = ("rating", "paired")
_SHOWN = {"object": str, "condition": str, "grasp": int, "perturbation": (None, {str: object})}
_KEY = {
    "study": str,
    "kind": set(KINDS),
    "levels": [str],
    "conditions": [str],
    "videos": {str: _SHOWN},
    "lists": [[[str]]],
    "record": {str: object},
}


@dataclass(frozen=True)
class Shown:
    """What a video shows.

    object: its name.
    condition: who made the grasp: a row of the evaluation; or `CATCH`, or `EXAMPLE`.
    grasp: number of the grasp in its condition.
    perturbation: of a catch trial: how the true grasp was moved, and what was measured of it then.
    """

    object: str
    condition: str
    grasp: int
    perturbation: dict[str, Any] | None = None


@dataclass(frozen=True)
class StudyKey:
    """A study as its analysis needs it.

    study: its id, which every answer names.
    kind: one of `KINDS`.
    levels: words of the possible answers, 1 … n.
    conditions: without catch trials, ground truth first.
    videos: by name.
    lists: for each list of trials, the trials that a rater of it sees: names of one video each, or of two.
    record: what the export was made with.
    """

    study: str
    kind: str
    levels: list[str]
    conditions: list[str]
    videos: dict[str, Shown]
    lists: list[list[list[str]]]
    record: dict[str, Any]

    @property
    def objects(self) -> list[str]:
        """Names, in order."""
        return list(dict.fromkeys(sorted(shown.object for shown in self.videos.values())))

    @cached_property
    def trials(self) -> list[frozenset[frozenset[str]]]:
        """Trials of each list, whatever their order and sides."""
        return [frozenset(frozenset(trial) for trial in trials) for trials in self.lists]

    def is_catch(self, videos: Sequence[str]) -> bool:
        """Whether a trial of these videos is a catch trial."""
        return any(self.videos[name].condition == CATCH for name in videos)

    def write(self, folder: Path) -> None:
        """Write the key into an export, readable by its owner alone."""
        path = folder / PRIVATE / "key.json"
        write_json(path, asdict(self))
        path.chmod(0o600)

    @classmethod
    def read(cls, folder: str | Path) -> StudyKey:
        """Read the key of an export.

        Raises:
            UserError: the folder holds no export, or one that is damaged.
        """
        folder = existing(Path(folder).expanduser(), "Export of a study")
        path = existing(folder / PRIVATE / "key.json", f"{folder} is no export of `grabnet study export`: the key")
        values = read_json(path, _KEY, "export the study again")
        videos = {name: Shown(**{field: shown[field] for field in _SHOWN}) for name, shown in values["videos"].items()}
        key = cls(**{field: values[field] for field in _KEY} | {"videos": videos})
        if reason := key._fault():
            raise UserError(f"{path} is damaged ({reason}): export the study again.")
        return key

    def _fault(self) -> str:
        """What does not fit together; empty where all does."""
        per_trial = 1 if self.kind == "rating" else 2
        trials = [trial for trials in self.lists for trial in trials]
        if any(name not in self.videos for trial in trials for name in trial):
            return "its lists name other videos than it has"
        if not all([trials, *self.lists]) or any({len(trial), len(set(trial))} != {per_trial} for trial in trials):
            return f"its lists are not of trials of {per_trial} videos"
        if len(self.levels) < 2 or (per_trial == 2 and len(self.levels) != 2):
            return "its levels are not as many as there can be answers"
        return ""
