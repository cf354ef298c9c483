"""The kinds of protocol, by what is measured at once: a grasp, an object's grasps, all of a method's, a network.

A new protocol is a class of one of these kinds in a file of `protocols/`, and a line in `registry.py`. Its metrics say
where tables, report and LaTeX show them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from grabnet.evaluation.bootstrap import Estimate
from grabnet.evaluation.cache import Arrays
from grabnet.evaluation.hands import Hands
from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.methods import Method
from grabnet.evaluation.metrics import Metric
from grabnet.evaluation.scene import GraspScene
from grabnet.geometry.mesh import Mesh


class EvaluationProtocol(ABC):
    """A way to measure grasps.

    Results are known by titles, `<name>/<result>`. Those with the title of a metric are numbers of the tables; others
    are data for further steps. Several protocols may share a name, if their titles differ.

    Attributes:
        name: first half of its titles.
        metrics: in the order of the tables.
    """

    name: str
    metrics: tuple[Metric, ...] = ()

    @classmethod
    def of(cls, inputs: EvaluationInputs) -> Self | None:
        """Return the protocol with an evaluation's settings; None where these leave it out."""
        return cls()

    def write(self, folder: Path, methods: Sequence[Method], inputs: EvaluationInputs) -> None:  # noqa: B027, optional
        """Write files of its own, if any, into the output folder, when all is measured."""


class PerGrasp(EvaluationProtocol):
    """Measure each grasp by itself: the result for one does not depend on which others are measured with it.

    Results are cached, under the class, its settings, the object and the hand, and computed in several processes.

    Attributes:
        settings: all values that results depend on.
        only_first: grasps per object that are measured; all when None.
        needs_truth: whether results depend on the recorded grasps of the object, `scene.truth`.
        highlight: result (N, V of the object) that is above 0 at vertices to be drawn red in the report's pictures.
        legend: of these pictures, a sentence.

    A result `failure` holds texts: why a grasp could not be measured, empty where it was.
    """

    settings: str = ""
    only_first: int | None = None
    needs_truth: bool = False
    highlight: str = ""
    legend: str = ""

    def prepare(self, meshes: Sequence[Mesh], processes: int) -> None:
        """Do what is better done once for each object than by every process that measures on it."""

    @abstractmethod
    def __call__(self, scene: GraspScene) -> dict[str, np.ndarray]:
        """Return arrays by the names of results; first dimension: hands; NaN where a number cannot be measured."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MeasuredGrasps:
    """A method's grasps of one object, and the recorded grasps of that object.

    Attributes:
        mesh: the object.
        hands: N grasps.
        truth: M recorded grasps.
        results: of the N, by title.
        truth_results: of the M, by title; only of the protocols in `PerObject.of_truth`.
    """

    mesh: Mesh
    hands: Hands
    truth: Hands
    results: Arrays
    truth_results: Arrays


class PerObject(EvaluationProtocol):
    """Measure a method's grasps of one object, from the hands and from results of the protocols before it.

    Attributes:
        of_truth: classes of `PerGrasp` protocols that it needs of the object's recorded grasps, too.
    """

    of_truth: tuple[type[PerGrasp], ...] = ()

    @abstractmethod
    def __call__(self, grasps: MeasuredGrasps) -> dict[str, np.ndarray]:
        """Return arrays by the names of results, without those that cannot be measured."""


class PerMethod(EvaluationProtocol):
    """Measure all grasps of a method together."""

    @abstractmethod
    def __call__(self, method: Method) -> dict[str, Estimate]:
        """Return estimates by the names of metrics, without those that cannot be measured."""


@dataclass(frozen=True)
class Score:
    """What was measured of a network.

    Attributes:
        network: its name.
        split: of the frames.
        object: of the frames; `ALL` for all of the split, each frame weighing the same.
        values: by the names of the protocol's metrics, in their units.
        n: frames.
    """

    network: str
    split: str
    object: str
    values: dict[str, float]
    n: int


class PerNetwork(EvaluationProtocol):
    """Measure networks, on frames of all splits."""

    @abstractmethod
    def __call__(self) -> list[Score]:
        """Return scores by network, split, and object, `ALL` before objects."""
