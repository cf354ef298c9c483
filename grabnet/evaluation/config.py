"""Settings of an evaluation: the values of `configs/evaluate.yaml`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra.utils import instantiate

from grabnet.body.hand import HandModel
from grabnet.cli.checks import at_least, one_of, positive
from grabnet.data.splits import SPLITS
from grabnet.generation.config import usable_device
from grabnet.generation.grabber import Grabber
from grabnet.models.generator import GraspGenerator


@dataclass(frozen=True)
class EvaluationConfig:
    """The values of `configs/evaluate.yaml`, which explains them.

    contact, data, hand_model, source, physics, optimiser and ranking are configs of what their groups make.

    Raises:
        UserError: a value out of range.
    """

    models: str | list[Any]
    runs: str
    grasps: str | list[str] | None
    output: str
    split: str
    only: list[str] | None
    n: int
    seed: int
    optimise: int
    candidates: int
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
    device: str
    cache_dir: str | None
    objects: dict[str, Any]
    contact: dict[str, Any]
    hand_model: dict[str, Any]
    data: dict[str, Any]
    source: dict[str, Any]
    physics: dict[str, Any]
    optimiser: dict[str, Any]
    ranking: dict[str, Any]

    def __post_init__(self):
        at_least(self, n=1, optimise=0, candidates=1)
        at_least(self, halo_samples=1, vertex_samples=1, contact_samples=1, processes=1)
        at_least(self, max_ground_truth=2, draws=2, seed=0, simulated=0, pictures=0, scenes=0)
        one_of(self, split=SPLITS)
        positive(self, "contact_distance")
        usable_device(self.device)

    @property
    def treatment(self) -> dict[str, Any]:
        """What is done to the grasps that generators draw: options of a `Grabber`."""
        chosen = {"optimiser": instantiate(self.optimiser), "ranking": instantiate(self.ranking)}
        return {"optimise": self.optimise, "candidates": self.candidates} | chosen

    def treated(self, generator: GraspGenerator, hand: HandModel) -> Grabber:
        """Draws from a generator as from the models that are evaluated."""
        return Grabber(generator, hand, **self.treatment).to(usable_device(self.device))

    @property
    def folders(self) -> list[Path]:
        """Folders of grasps made by other methods."""
        named = [self.grasps] if isinstance(self.grasps, str) else self.grasps or []
        return [Path(name).expanduser() for name in named]
