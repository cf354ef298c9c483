"""A queue that wants its machine back."""

from __future__ import annotations

import os
import signal

import lightning as L


class Interrupted(L.Callback):
    """Sends a run that began at its first epoch, in its third, what submitit has queues send before they take a machine
    away."""

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        self._due = trainer.current_epoch == 0

    def on_train_epoch_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        if self._due and trainer.current_epoch == 2:
            os.kill(os.getpid(), signal.SIGUSR2)
