"""What a report shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from grabnet.analysis.frames import Subset
from grabnet.analysis.statistic import Analysed, Heats, Row

# Label of a table that subtracts two.
DIFFERENCE = "difference"


@dataclass(frozen=True)
class Section:
    """A statistic: its tables by data set, then their difference; whether there was something to draw."""

    name: str
    title: str
    about: str
    tables: dict[str, list[Row]]
    is_drawn: bool


@dataclass(frozen=True)
class Findings:
    """Everything that was found.

    Attributes:
        analysed: the data sets.
        subset: what of them is shown.
        sections: of statistics.
        agreement: published numbers beside those of the first data set.
        heats: meshes to turn, by name.
        failures: what could not be counted or was not found, in sentences.
        no_pictures: why this machine draws no pictures; None where it does.
        record: what it was made with.
    """

    analysed: Sequence[Analysed]
    subset: Subset
    sections: Sequence[Section]
    agreement: Sequence[Row]
    heats: Mapping[str, Heats]
    failures: Sequence[str]
    no_pictures: str | None
    record: dict[str, Any]
