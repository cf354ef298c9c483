"""What a number in the evaluation is: its protocol, unit, definition, and which way is better."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from grabnet.evaluation.scene import Scene


@dataclass(frozen=True)
class Metric:
    """A number of each grasp, or of many together.

    Attributes:
        protocol, name: what it is called by, both together.
        unit: "%" for shares: of a grasp these are 0 or 1, or a share.
        about: definition, a sentence.
        better: "lower", "higher", or None where neither is.
        samples: grasps per object that count, the first; all when None.
    """

    protocol: str
    name: str
    unit: str
    about: str
    better: str | None = None
    samples: int | None = None

    @property
    def title(self) -> str:
        return f"{self.protocol}/{self.name}"

    @property
    def scale(self) -> float:
        """From stored values to the unit."""
        return 100.0 if self.unit == "%" else 1.0


class PerGrasp(Protocol):
    """Measures each grasp by itself: the result for one does not depend on which others are measured with it.

    name and settings make up what results are kept under.
    """

    name: str
    settings: str
    metrics: tuple[Metric, ...]

    def __call__(self, scene: Scene) -> dict[str, np.ndarray]:
        """Arrays whose first dimension is the hands'; NaN for what cannot be measured. Names beyond those of the
        metrics are data that other steps use."""
        ...
