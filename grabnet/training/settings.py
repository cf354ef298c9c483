"""What a training run is made from: the values of `configs/train.yaml`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from grabnet.cli.checks import at_least, one_of
from grabnet.errors import UserError
from grabnet.training.acceleration import PRECISIONS


@dataclass(frozen=True)
class TrainingConfig:
    """The values of `configs/train.yaml`, which explains them. objects, hand_model, data, model, trainer, callbacks and
    logger are configs of what their groups make.

    Raises:
        UserError: a value out of range.
    """

    seed: int
    run_dir: str
    sweep_dir: str
    tags: list[str]
    objective: str
    resume: bool
    matmul_precision: str
    compile: bool
    test: bool
    objects: dict[str, Any]
    hand_model: dict[str, Any]
    data: dict[str, Any]
    model: dict[str, Any]
    trainer: dict[str, Any]
    callbacks: dict[str, Any]
    logger: dict[str, Any]
    quiet: bool = False  # for the command

    def __post_init__(self):
        at_least(self, seed=0)
        if self.seed >= 2**32:  # the bound of numpy's and Lightning's seeds
            raise UserError(f"seed is {self.seed}; it must be below {2**32}.")
        one_of(self, matmul_precision=PRECISIONS)
