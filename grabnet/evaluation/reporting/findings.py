"""All that an evaluation found, as tables and report show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from grabnet.evaluation.methods import Method
from grabnet.evaluation.metrics import ALL, Metric, Section
from grabnet.evaluation.protocol import Score
from grabnet.evaluation.summary import Figure
from grabnet.geometry.mesh import Mesh


@dataclass(frozen=True)
class Highlight:
    """What the pictures of grasps show in red.

    Attributes:
        title: of a result (N, V of the object), above 0 at red vertices.
        legend: a sentence.
    """

    title: str
    legend: str


@dataclass(frozen=True, eq=False, kw_only=True)
class Findings:
    """All that an evaluation found.

    Attributes:
        methods: in the order of the tables.
        objects: meshes by name.
        metrics: of all protocols, in order.
        figures: numbers of the tables.
        scores: of networks, by protocol.
        unexpected_order: sentences on methods that come out in the wrong order.
        failures: sentences on grasps that could not be measured.
        highlight: of pictures, where a protocol has one.
        split: of the objects.
        record: what all was made with, ready for JSON.
    """

    methods: Sequence[Method]
    objects: dict[str, Mesh]
    metrics: Sequence[Metric]
    figures: Sequence[Figure]
    scores: dict[str, list[Score]]
    unexpected_order: Sequence[str]
    failures: Sequence[str]
    highlight: Highlight | None
    split: str
    record: dict[str, Any]

    @property
    def measured(self) -> list[Metric]:
        """Metrics of grasps of which anything was measured."""
        there = {figure.metric for figure in self.figures}
        return [metric for metric in self.metrics if metric in there]

    @property
    def headlines(self) -> list[Metric]:
        """Those of them that first tables show."""
        return [metric for metric in self.measured if metric.headline]

    @property
    def by_object(self) -> list[Metric]:
        """Those of them that are known of single objects, too; without metrics of parts of the hand."""
        there = {figure.metric for figure in self.figures if figure.object != ALL}
        return [metric for metric in self.metrics if metric in there and not metric.part]

    @property
    def scored(self) -> list[Metric]:
        """Metrics of networks of which anything was measured."""
        return [metric for metric in self.metrics if self.scores.get(metric.protocol)]

    @property
    def sections(self) -> list[Section]:
        """Sections of all that was measured, in the order of the metrics."""
        there = {*self.measured, *self.scored}
        return list(dict.fromkeys(metric.section for metric in self.metrics if metric in there))

    def highlighted(self, method: Method, object_name: str) -> np.ndarray:
        """Return (N, V) bool: vertices of the object to be drawn red for each grasp of a method."""
        if self.highlight is None:
            return np.zeros((len(method.hands[object_name]), len(self.objects[object_name].vertices)), bool)
        return method.results[object_name][self.highlight.title] > 0
