"""What an analysis is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from grabnet.analysis.data_set import DataSet
from grabnet.analysis.frames import Subset
from grabnet.analysis.rules import Rules
from grabnet.cli.checks import Concurrent, Count, Distance, Name, in_range
from grabnet.contact.rules import ContactRules
from grabnet.data.intents import INTENTS
from grabnet.errors import UserError


@dataclass(frozen=True)
class AnalyzeConfig:
    """The values of `configs/analyze/analyze.yaml`, which explains them.

    Raises:
        UserError: a value out of range, an intent that there is not, or two data sets of one label.
    """

    data: DataSet
    compare: DataSet | None
    rules: Rules
    output: Name
    intents: Sequence[str] | None
    subjects: Sequence[str] | None
    objects: Sequence[str] | None
    scenes: bool
    contact_distance: Distance
    workers: Concurrent
    dask_address: str | None
    max_deaths: Count
    contact: ContactRules = field(default_factory=ContactRules)  # for `data`, whose config refers to it
    quiet: bool = False  # for the command

    def __post_init__(self):
        in_range(self)
        if unknown := [name for name in self.intents or () if name not in INTENTS]:
            raise UserError(f"intents names {', '.join(unknown)}: there are {', '.join(INTENTS)}.")
        if self.compare is not None and self.compare.label == self.data.label:
            raise UserError(f"Both data sets are called {self.data.label}: give compare.label another name.")

    @property
    def root(self) -> Path:
        return Path(self.output).resolve()

    @property
    def data_sets(self) -> list[DataSet]:
        return [self.data] if self.compare is None else [self.data, self.compare]

    @property
    def subset(self) -> Subset:
        return Subset(self.intents, self.subjects, self.objects)
