"""A statistic of a data set: one accumulator, which counts frames, and one figure.

To add one, write a subclass of `Statistic` and name it in `grabnet.analysis.registry.STATISTICS`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from grabnet.analysis.data_set import DataSet
from grabnet.analysis.frames import ALL, Frames, Group, Subset
from grabnet.analysis.rules import Rules
from grabnet.data.intents import INTENTS

# A line of a table: texts say what it is of, numbers what was found.
Row = dict[str, Any]


class Heats(NamedTuple):
    """How often the vertices of a mesh are touched, in several subsets, which share a scale.

    vertices: (V, 3) metres. faces: (F, 3). up: axis of the mesh that points upwards, "y" or "z".
    shares: (V,) by name. changes: (V,) differences of shares, by name.
    """

    vertices: np.ndarray
    faces: np.ndarray
    up: str
    shares: dict[str, np.ndarray]
    changes: dict[str, np.ndarray]


class Statistic(ABC):
    """Sums over frames, by group.

    Args:
        rules: which frames count, and how finely.

    Attributes:
        by: what `result` and `draw` tell apart. The parts of a pass are merged over the rest, so that memory depends on
            how many of these there are, and not on how much was recorded.
        sums: an array by group and name; what `merge` adds up.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    about: ClassVar[str]
    by: ClassVar[Collection[str]] = Group._fields

    def __init__(self, rules: Rules):
        self.rules = rules
        self.sums: dict[tuple[Group, str], np.ndarray] = {}

    @abstractmethod
    def add(self, frames: Frames) -> None:
        """Count the frames of a sequence."""

    def merge(self, other: Statistic) -> None:
        """Take what another one of the same kind has counted; its arrays may be kept."""
        for (group, what), value in other.sums.items():
            self.count(group, what, value)

    @abstractmethod
    def result(self, subset: Subset) -> list[Row]:
        """Lines of the table; none where nothing was counted."""

    @classmethod
    @abstractmethod
    def draw(cls, analysed: Sequence[Analysed]) -> Figure | None:
        """Draw the figure, data sets side by side with one scale; None where there is nothing to draw."""

    @classmethod
    def heats(cls, analysed: Sequence[Analysed]) -> dict[str, Heats]:
        """Meshes to turn in 3-D, by name."""
        return {}

    def count(self, group: Group, what: str, value: Any) -> None:
        """Add to a sum."""
        key = group, what
        self.sums[key] = self.sums[key] + value if key in self.sums else np.asarray(value)

    def total(self, what: str, subset: Subset) -> Any:
        """Sum over the groups of a subset; 0 where there are none.

        Raises:
            ValueError: the subset names a field that this statistic does not count by.
        """
        self._can_choose(subset)
        return sum((value for (group, name), value in self.sums.items() if name == what and group in subset), 0)

    def groups(self, subset: Subset) -> list[Group]:
        """Those of a subset that were counted; raises as `total`."""
        self._can_choose(subset)
        return sorted({group for group, _ in self.sums if group in subset})

    def _can_choose(self, subset: Subset) -> None:
        if merged := subset.by.keys() - set(self.by):
            raise ValueError(f"{self.name} does not tell {', '.join(sorted(merged))} apart: name it in `by`.")

    def by_intent(self, subset: Subset) -> Iterator[tuple[str, Subset]]:
        """The subset's part of each intent that was counted, after "all"."""
        groups = self.groups(subset)
        there = {group.intent for group in groups if group.intent}
        if groups:
            yield "all", subset
        for intent in sorted(there, key=lambda name: (INTENTS.index(name) if name in INTENTS else 9, name)):
            yield intent, Subset([intent], subset.subjects, subset.objects)


@dataclass(frozen=True)
class Analysed:
    """A data set, and what was counted of its groups that were chosen."""

    data: DataSet
    statistics: Mapping[str, Statistic] = field(default_factory=dict)

    @property
    def label(self) -> str:
        return self.data.label

    def rows(self, statistic: type[Statistic]) -> list[Row]:
        """The table of a statistic."""
        return self.statistics[statistic.name].result(ALL)
