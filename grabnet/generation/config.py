"""What to sample: the values of `configs/sample/sample.yaml`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import torch

from grabnet.cli.checks import Amount, Batch, Betas, Count, Distance, Filled, Name, Positive, Seed, in_range, one_of
from grabnet.contact.rules import ContactRules
from grabnet.errors import UserError
from grabnet.generation.formats import FORMATS
from grabnet.generation.grabber import ORIENTATIONS, SIDES, check_hands
from grabnet.generation.ranking import RankingConfig
from grabnet.geometry.object_mesh import file_to_object
from grabnet.grasping.optimiser import OptimiserConfig


@dataclass(frozen=True)
class SamplingConfig:
    """What to sample; `configs/sample/sample.yaml` explains each value.

    Raises:
        UserError: a value that is wrong whatever the mesh.
    """

    mesh: Name | Annotated[list[Name], Filled()]
    output: Name
    n: Count
    seed: Seed
    hand: str
    format: str | list[str] | None
    scale: Positive
    max_size: Positive
    min_size: Positive
    up: str | None
    orientation: str
    betas: Betas | None
    model: Name | Annotated[list[Name], Filled()]
    refine: bool
    runs: str
    hand_model: str | None
    contact_distance: Distance
    table: bool
    contact_maps: bool
    sheet: Amount
    page: Amount
    optimise: Amount
    candidates: Count
    batch_size: Batch
    n_turns: Batch
    device: str
    cache_dir: str | None
    contact: ContactRules = field(default_factory=ContactRules)
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    ranking: RankingConfig = field(default_factory=RankingConfig)
    quiet: bool = False  # for the command

    def __post_init__(self):
        in_range(self)
        one_of(self, hand=SIDES, orientation=ORIENTATIONS)
        check_hands(self.n, self.candidates)
        file_to_object("", self.scale, self.up)  # refuses a wrong scale or axis
        if wrong := [b for b in self.betas or [] if not isinstance(b, float | int)]:
            raise UserError(f"betas holds {wrong[0]!r}; it must be a list of numbers.")
        if unknown := [f for f in listed(self.format) if f not in FORMATS]:
            raise UserError(f"format is '{unknown[0]}'; it can be any of {', '.join(FORMATS)}.")
        usable_device(self.device)


def listed(value: str | list[str] | None) -> list[str]:
    """A value that may be one string or a list of them, as a list."""
    return [value] if isinstance(value, str) else list(value or [])


def usable_device(name: str) -> torch.device:
    """The device of this name; "auto" is the GPU where there is one.

    Raises:
        UserError: no device of torch's, or a GPU that this machine does not have.
    """
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(name)
    except RuntimeError:
        device = None
    if device is None or device.type not in ("cpu", "cuda"):
        raise UserError(f"device is '{name}'; it can be auto, cpu, cuda or cuda:<number>.")
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise UserError(f"device is '{name}', but torch finds {torch.cuda.device_count()} GPUs here; use device=cpu.")
    return device
