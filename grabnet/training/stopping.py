"""Callbacks that end a run before its last epoch, and what has ended one."""

from __future__ import annotations

import signal
import threading

import lightning as L
from lightning.pytorch.callbacks import EarlyStopping, Timer

from grabnet.errors import UserError


class StopStaysStopped(L.Callback):
    """Keeps a run over that had stopped early: Lightning forgets that, and would train an epoch more at each resume."""

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        trainer.should_stop |= any(getattr(callback, "stopped_epoch", 0) for callback in trainer.callbacks)


class EndsAtOnce(L.Callback):
    """Answers SIGTERM as before the training. Lightning's own handler lets a run end as if it were complete, or waits
    for what other processes, which got no signal, do not send.
    """

    def __init__(self):
        self.handler = signal.getsignal(signal.SIGTERM)

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        self._restore()

    def on_test_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        self._restore()

    def _restore(self) -> None:
        """Lightning has set its handler a moment ago."""
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, self.handler)


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


def ended_by(trainer: L.Trainer) -> str:
    """What a training that has ended was ended by: "max_epochs", "max_steps", "early_stopping", "max_time" (also within
    the last epoch) or "callback", for another one.
    """
    timers = [callback for callback in trainer.callbacks if isinstance(callback, Timer)]
    is_cut = not trainer.is_last_batch or trainer.current_epoch != trainer.max_epochs
    if is_cut and any((timer.time_remaining() or 0) <= 0 for timer in timers):
        return "max_time"
    if any(isinstance(callback, EarlyStopping) and callback.stopped_epoch for callback in trainer.callbacks):
        return "early_stopping"
    if trainer.max_epochs not in (None, -1) and trainer.current_epoch >= trainer.max_epochs:
        return "max_epochs"
    if 0 <= trainer.max_steps <= trainer.global_step:
        return "max_steps"
    return "callback"
