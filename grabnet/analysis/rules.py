"""Which frames are counted, and how finely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any

from grabnet.cli.checks import Amount, Count, Filled, Several, Weight, in_range


@dataclass(frozen=True)
class Rules:
    """The values of `configs/analyze/analyze.yaml`, below `rules`, which explains them.

    Raises:
        UserError: a value out of range.
    """

    min_lift: Weight
    min_body_vertices: Amount
    posed_every: Count
    lifts: Annotated[Sequence[Weight], Filled()]
    finger_vertices: Annotated[Sequence[Count], Filled()]
    clusters: Several
    grasps_per_sequence: Count
    grasps_per_object: Several
    seed: Amount

    def __post_init__(self):
        in_range(self, "rules.")

    @property
    def of_counting(self) -> dict[str, Any]:
        """Those that decide what is counted; the others are of what is made of it."""
        return {name: value for name, value in asdict(self).items() if name not in ("clusters", "seed")}
