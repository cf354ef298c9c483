"""Settings of an evaluation: the values of `configs/evaluate.yaml`."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra.utils import instantiate

from grabnet.body.hand import HandModel
from grabnet.cli.checks import Amount, Concurrent, Count, Distance, Name, Seed, Several, in_range, one_of
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
    output: Name
    split: str
    only: list[str] | None
    n: Count
    seed: Seed
    optimise: Amount
    candidates: Count
    contact_distance: Distance
    halo_samples: Count
    vertex_samples: Count
    contact_samples: Count
    max_ground_truth: Several
    draws: Several
    reconstruction: bool
    simulated: Amount
    pictures: Amount
    scenes: Amount
    processes: Concurrent
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
    quiet: bool = False  # for the command

    def __post_init__(self):
        in_range(self)
        one_of(self, split=SPLITS)
        usable_device(self.device)

    @property
    def treatment(self) -> dict[str, Any]:
        """What is done to the grasps that generators draw: options of a `Grabber`."""
        chosen = {"optimiser": instantiate(self.optimiser), "ranking": instantiate(self.ranking)}
        return {"optimise": self.optimise, "candidates": self.candidates} | chosen

    def treated(self, generator: GraspGenerator, hand: HandModel) -> Grabber:
        """Draws from a generator as from the models that are evaluated, with a hand of its own on the device."""
        return Grabber(generator, deepcopy(hand), **self.treatment).to(usable_device(self.device))

    @property
    def folders(self) -> list[Path]:
        """Folders of grasps made by other methods."""
        named = [self.grasps] if isinstance(self.grasps, str) else self.grasps or []
        return [Path(name).expanduser() for name in named]
