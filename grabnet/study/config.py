"""Settings of a study's export: the values of `configs/study/export.yaml`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from grabnet.cli.checks import Amount, Concurrent, Count, Seed, in_range, one_of
from grabnet.data.splits import SPLITS
from grabnet.errors import UserError
from grabnet.study.catches import CatchConfig
from grabnet.study.key import KINDS
from grabnet.study.records import PLATFORM_ID
from grabnet.visual.turntable import FilmConfig


@dataclass(frozen=True)
class Texts:
    """What raters read; `configs/study/export.yaml` explains each."""

    title: str
    statement: str
    question: str
    levels: list[str]
    sides: list[str]
    consent: str
    instructions: str
    instructions_paired: str
    plausible: str
    implausible: str
    thanks: str

    def __post_init__(self):
        if not 2 <= len(self.levels) <= 9 or len(set(self.levels)) < len(self.levels):
            raise UserError(f"text.levels is {list(self.levels)}; it must be 2 to 9 different words, worst to best.")
        if len(set(self.sides)) != 2 or len(self.sides) != 2:
            raise UserError(f"text.sides is {list(self.sides)}; it must be 2 different words.")


@dataclass(frozen=True)
class ExportConfig:
    """The values of `configs/study/export.yaml`, which explains them.

    Raises:
        UserError: a value out of range.
    """

    models: str | list[str]
    runs: str
    grasps: str | list[str] | None
    objects: str | list[str]
    conditions: list[str] | None
    evaluation: list[str]
    n: Count
    catches: Amount
    seed: Seed
    output: str
    kind: str
    shown: Count | None
    catches_shown: Amount | None
    lists: Count
    completion_code: str | None
    processes: Concurrent
    catch: CatchConfig
    film: FilmConfig
    text: Texts
    quiet: bool = False  # for the command

    def __post_init__(self):
        in_range(self)
        one_of(self, kind=KINDS)
        code = self.completion_code
        if code is not None and not (isinstance(code, str) and PLATFORM_ID.fullmatch(code)):
            raise UserError(f"completion_code is {code!r}; it must be letters and digits, as Prolific gives it.")
        if isinstance(self.objects, str) and self.objects not in SPLITS:
            raise UserError(
                f"objects is {self.objects}; it can be {', '.join(SPLITS)}, or names of test objects, as in "
                f"[{self.objects}]."
            )

    @property
    def folder(self) -> Path:
        """Where the study lies."""
        return Path(self.output).expanduser()

    @property
    def levels(self) -> list[str]:
        """Words of the possible answers, 1 … n."""
        return list(self.text.levels if self.kind == "rating" else self.text.sides)
