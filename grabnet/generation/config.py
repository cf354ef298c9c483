"""What to sample: the values of `configs/sample/sample.yaml`."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch

from grabnet.cli.checks import at_least, one_of, positive
from grabnet.contact.rules import ContactRules
from grabnet.errors import UserError
from grabnet.generation.formats import FORMATS
from grabnet.generation.grabber import ORIENTATIONS, SIDES
from grabnet.generation.ranking import RankingConfig
from grabnet.geometry.object_mesh import file_to_object
from grabnet.grasping.optimiser import OptimiserConfig


@dataclass(frozen=True)
class SamplingConfig:
    """What to sample; `configs/sample/sample.yaml` explains each value.

    Raises:
        UserError: a value that is wrong whatever the mesh.
    """

    mesh: str | list[str]
    output: str
    n: int
    seed: int
    hand: str
    format: str | list[str] | None
    scale: float
    max_size: float
    min_size: float
    up: str | None
    orientation: str
    betas: list[float] | None
    model: str | list[str]
    refine: bool
    runs: str
    hand_model: str | None
    contact_distance: float
    contact_maps: bool
    sheet: int
    page: int
    optimise: int
    candidates: int
    batch_size: int
    n_turns: int
    device: str
    cache_dir: str | None
    contact: ContactRules = field(default_factory=ContactRules)
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    ranking: RankingConfig = field(default_factory=RankingConfig)

    def __post_init__(self):
        at_least(self, n=1, seed=0, optimise=0, candidates=1, batch_size=1, n_turns=1, sheet=0, page=0)
        one_of(self, hand=SIDES, orientation=ORIENTATIONS)
        file_to_object("", self.scale, self.up)  # refuses a wrong scale or axis
        if wrong := [b for b in self.betas or [] if not isinstance(b, float | int)]:
            raise UserError(f"betas holds {wrong[0]!r}; it must be a list of numbers.")
        if unknown := [f for f in listed(self.format) if f not in FORMATS]:
            raise UserError(f"format is '{unknown[0]}'; it can be any of {', '.join(FORMATS)}.")
        positive(self, "contact_distance")
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
