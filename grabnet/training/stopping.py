"""Callbacks that end a run before its last epoch."""

from __future__ import annotations

import lightning as L

from grabnet.errors import UserError


class StopStaysStopped(L.Callback):
    """Keeps a run over that had stopped early: Lightning forgets that, and would train an epoch more at each resume."""

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        trainer.should_stop |= any(getattr(callback, "stopped_epoch", 0) for callback in trainer.callbacks)


class ObjectiveMeasured(L.Callback):
    """Ends a run whose objective is not among what the first validated epoch measured.

    Args:
        objective: the metric that the run is judged by.

    Raises:
        UserError: from the epoch's end, through `Trainer.fit`.
    """

    def __init__(self, objective: str):
        self.objective = objective

    def on_train_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        measured = trainer.callback_metrics
        validated = (trainer.current_epoch + 1) % (trainer.check_val_every_n_epoch or 1) == 0
        if self.objective not in measured and validated and not trainer.should_stop:  # for which time may have run out
            raise UserError(f"objective={self.objective} is not measured; what is: {', '.join(sorted(measured))}.")
