"""What a training run is made from: the values of `configs/train.yaml`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated, Any

from grabnet.cli.checks import MOST_AT_ONCE, Name, Positive, Range, Seed, Weight, in_range, mismatch, one_of
from grabnet.errors import UserError
from grabnet.training.acceleration import PRECISIONS

# Of values that libraries take: some they check only once the data are there, some never.
_LIBRARIES = {
    "model.optimizer.lr": Positive,
    "model.optimizer.weight_decay": Weight,
    "trainer.max_epochs": Annotated[int, Range(-1)],  # -1: no limit
    "trainer.check_val_every_n_epoch": Annotated[int, Range(1)],
    "trainer.log_every_n_steps": Annotated[int, Range(0)],
    "trainer.num_sanity_val_steps": Annotated[int, Range(-1)],
    "trainer.devices": Annotated[int, Range(-1, MOST_AT_ONCE)],  # -1: all
    "trainer.num_nodes": Annotated[int, Range(1)],
    "callbacks.early_stopping.patience": Annotated[int, Range(0)],
    "callbacks.checkpoint.every_n_epochs": Annotated[int, Range(1)],
    "callbacks.last.every_n_epochs": Annotated[int, Range(1)],
}
_DURATION = re.compile(r"\d+:\d\d:\d\d:\d\d", re.ASCII)


@dataclass(frozen=True)
class TrainingConfig:
    """The values of `configs/train.yaml`, which explains them. objects, hand_model, data, model, trainer, callbacks and
    logger are configs of what their groups make.

    Raises:
        UserError: a value out of range.
    """

    seed: Seed
    run_dir: Name
    sweep_dir: Name
    trial: bool
    tags: list[str]
    objective: Name
    resume: bool
    matmul_precision: str
    compile: bool
    test: bool
    objects: dict[str, Any]
    hand_model: dict[str, Any]
    data: dict[str, Any]
    model: dict[str, Any]
    trainer: dict[str, Any]
    callbacks: dict[str, dict[str, Any] | None]
    logger: dict[str, dict[str, Any] | None]
    quiet: bool = False  # for the command

    def __post_init__(self):
        in_range(self)
        for key, hint in _LIBRARIES.items():
            if found := mismatch(_value(self, key.split(".")), hint):
                raise UserError(f"{key} is {found[0]!r}; it {found[1]}.")
        one_of(self, matmul_precision=PRECISIONS)
        limit = _value(self, ["trainer", "max_time"])
        if isinstance(limit, str) and not _DURATION.fullmatch(limit):
            raise UserError(f"trainer.max_time is {limit!r}; it must be null or DD:HH:MM:SS, as in 00:12:00:00.")


def _value(node: Any, path: list[str]) -> Any:
    """What lies at a path of attributes and keys; None where there is nothing."""
    for key in path:
        node = node.get(key) if isinstance(node, dict) else getattr(node, key, None)
    return node
