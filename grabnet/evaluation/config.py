"""Settings of an evaluation: the values of `configs/evaluate.yaml`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from grabnet.data.datamodule import SPLITS
from grabnet.errors import UserError


@dataclass(frozen=True)
class EvaluationConfig:
    """The values of `configs/evaluate.yaml`, which explains them.

    data, hand_model, source and physics are configs of what their groups make.

    Raises:
        UserError: a value out of range.
    """

    coarsenet: str | None
    refinenet: str | None
    runs: str
    grasps: str | list[str] | None
    output: str
    split: str
    only: list[str] | None
    n: int
    seed: int
    contact_distance: float
    halo_samples: int
    vertex_samples: int
    contact_samples: int
    max_ground_truth: int
    draws: int
    reconstruction: bool
    simulated: int
    pictures: int
    scenes: int
    processes: int
    cache_dir: str | None
    objects: dict[str, Any]
    hand_model: dict[str, Any]
    data: dict[str, Any]
    source: dict[str, Any]
    physics: dict[str, Any]

    def __post_init__(self):
        least = dict.fromkeys(("n", "halo_samples", "vertex_samples", "contact_samples", "processes"), 1)
        for name, bound in (
            least | {"max_ground_truth": 2, "draws": 2, "seed": 0, "simulated": 0, "pictures": 0, "scenes": 0}
        ).items():
            if getattr(self, name) < bound:
                raise UserError(f"{name} is {getattr(self, name)}; it must be at least {bound}.")
        if self.split not in SPLITS:
            raise UserError(f"split is '{self.split}'; it can be {', '.join(SPLITS)}.")
        if not self.contact_distance > 0:
            raise UserError(f"contact_distance is {self.contact_distance}; it must be positive, in metres.")

    @property
    def folders(self) -> list[Path]:
        """Folders of grasps made by other methods."""
        named = [self.grasps] if isinstance(self.grasps, str) else self.grasps or []
        return [Path(name).expanduser() for name in named]
