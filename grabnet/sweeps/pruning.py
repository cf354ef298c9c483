"""Ending runs that fall behind the others of their sweep."""

from __future__ import annotations

from pathlib import Path
from statistics import median

import lightning as L

from grabnet.cli.checks import Amount, Count
from grabnet.training.ending import RunPruned
from grabnet.training.history import Epoch, History, best_epoch, read_history


class MedianPruning(L.Callback):
    """Ends a run whose best objective so far is worse than the median of its siblings' best until the same epoch.

    It reads what the siblings have written (`history.json`), finished or not, on this machine or another: it works in
    any sweep whose runs share a folder.

    Args:
        siblings: the folder of the sweep, which holds the runs' folders.
        objective: the metric compared; smaller is better.
        min_epochs: that a run may have in any case.
        min_siblings: that must have come as far before any is ended.

    Raises:
        RunPruned: from the epoch's end, through `Trainer.fit`.
    """

    def __init__(self, siblings: str, objective: str, min_epochs: Amount, min_siblings: Count):
        self.siblings, self.objective = Path(siblings), objective
        self.min_epochs, self.min_siblings = min_epochs, min_siblings

    def on_train_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        history = next(c for c in trainer.callbacks if isinstance(c, History))
        others = [p for p in self.siblings.glob("*/") if p.resolve() != Path(trainer.default_root_dir).resolve()]
        verdict = self.verdict(history.epochs, [read_history(p) for p in others])
        if verdict := trainer.strategy.broadcast(verdict):  # no process may stay behind
            raise RunPruned(verdict)

    def verdict(self, own: list[Epoch], others: list[list[Epoch]]) -> str | None:
        """Why a run with these epochs should end; None where it should go on."""
        n = len(own)
        bests = [best_epoch(epochs[:n], self.objective) for epochs in others if len(epochs) >= n]
        reached = [best[self.objective] for best in bests if best is not None]
        if n < self.min_epochs or len(reached) < self.min_siblings:
            return None
        best = best_epoch(own, self.objective)
        if best is not None and best[self.objective] <= median(reached):
            return None
        shown = f"{best[self.objective]:.4g}" if best else "never finite"
        compared = f"the median of {len(reached)} other runs is {median(reached):.4g}"
        return f"{self.objective} is {shown} after {n} epochs; {compared}."
