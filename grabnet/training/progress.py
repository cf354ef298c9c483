"""How far a training has come."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import lightning as L

from grabnet.cli.progress import steps


class TrainingProgress(L.Callback):
    """Steps of all epochs, with the objective of the last one; then batches of the test. Shown by commands only.

    The time left is until the last epoch that the trainer allows: early stopping ends sooner.

    Args:
        objective: name of the metric.
    """

    def __init__(self, objective: str):
        self.objective = objective
        self._shown = ExitStack()

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        epochs, of_epoch = trainer.max_epochs or -1, trainer.num_training_batches
        self._show("Training", epochs * of_epoch if epochs > 0 else None, trainer.current_epoch * of_epoch)

    def on_train_epoch_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        last = trainer.callback_metrics.get(self.objective)
        about = f"epoch {trainer.current_epoch + 1} of {trainer.max_epochs}"
        self._counted.advance(0, about if last is None else f"{about}, {self.objective} {float(last):.4g}")

    def on_train_batch_end(
        self, trainer: L.Trainer, pl_module: L.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        self._counted.advance()

    def on_test_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        self._show("Testing", sum(trainer.num_test_batches))

    def on_test_batch_end(
        self,
        trainer: L.Trainer,
        pl_module: L.LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        self._counted.advance()

    def on_exception(self, trainer: L.Trainer, pl_module: L.LightningModule, exception: BaseException) -> None:
        self._shown.close()

    def teardown(self, trainer: L.Trainer, pl_module: L.LightningModule, stage: str) -> None:
        self._shown.close()

    def _show(self, what: str, total: float | None, done: float = 0) -> None:
        self._shown.close()
        self._counted = self._shown.enter_context(steps(what, total, done))
