"""What a run measured, epoch by epoch, in one small file that other runs and reports read while it goes on."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import lightning as L

from grabnet.io.files import write_json
from grabnet.io.state import Finite, Kind, read_json

HISTORY = "history.json"

Epoch = dict[str, float]
_EPOCH: Kind = {"epoch?": int, "seconds?": Finite(0), "*": float}


class History(L.Callback):
    """Writes `history.json` into the run folder: for each epoch its number, the seconds of training until its end (of
    earlier attempts too) and every metric.
    """

    def __init__(self):
        self.epochs: list[Epoch] = []

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        self._start = time.monotonic() - (self.epochs[-1]["seconds"] if self.epochs else 0.0)

    def on_train_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        metrics = {name: float(value) for name, value in trainer.callback_metrics.items()}
        seconds = round(time.monotonic() - self._start, 2)
        self.epochs.append({"epoch": trainer.current_epoch, "seconds": seconds, **metrics})
        if trainer.is_global_zero:
            write_json(Path(trainer.default_root_dir) / HISTORY, self.epochs)

    def state_dict(self) -> dict[str, Any]:
        return {"epochs": self.epochs}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.epochs = state_dict["epochs"]


def read_history(run_dir: str | Path) -> list[Epoch]:
    """The epochs of a run so far; none where it has not come to the end of one.

    Raises:
        UserError: a damaged file.
    """
    path = Path(run_dir) / HISTORY
    return read_json(path, [_EPOCH], "delete it, or run that training again") if path.exists() else []


def best_epoch(epochs: list[Epoch], objective: str) -> Epoch | None:
    """The epoch with the smallest objective; None where it was never finite."""
    finite = [epoch for epoch in epochs if math.isfinite(epoch.get(objective, math.nan))]
    return min(finite, key=lambda epoch: epoch[objective], default=None)
