"""Checkpoints of training runs: written whole or not at all, read without pickles."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from lightning.fabric.plugins import TorchCheckpointIO
from torch import Tensor

from grabnet.errors import UserError, printable
from grabnet.io import checkpoints
from grabnet.io.files import replacing

BEST, LAST, PREVIOUS = "best.ckpt", "last.ckpt", "last.previous.ckpt"

log = logging.getLogger(__name__)


class AtomicCheckpointIO(TorchCheckpointIO):
    """Lightning's checkpoint files, moved into place only once they are complete and on the disk.

    `last.ckpt` steps aside to `last.previous.ckpt` for its successor: there is a whole one at every instant, and still
    one where the newest is damaged later.
    """

    def save_checkpoint(self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any = None) -> None:
        path = Path(path)
        with replacing(path) as temporary:
            with temporary.open("wb") as file:
                _save(checkpoint, file)
                os.fsync(file.fileno())
            if path.name == LAST and path.exists():
                path.replace(path.with_name(PREVIOUS))

    def load_checkpoint(
        self, path: str | Path, map_location: Any = None, weights_only: bool | None = None
    ) -> dict[str, Any]:
        return read_checkpoint(path)


def read_checkpoint(path: str | Path) -> dict[str, Any]:
    """The content of a checkpoint, on the CPU; tensors and plain containers only.

    Weights of a run that diverged are not finite; the run says so when it ends.

    Raises:
        UserError: damaged, or holding other objects.
    """
    checkpoint = checkpoints.read_checkpoint(path, "Checkpoint", "delete it")
    weights = checkpoint.get("state_dict") if isinstance(checkpoint, dict) else None
    if not isinstance(weights, Mapping) or not all(isinstance(value, Tensor) for value in weights.values()):
        raise UserError(f"Checkpoint {path} cannot be read (it holds no state_dict of tensors): delete it.")
    return checkpoint


def newest_whole(folder: str | Path) -> Path | None:
    """Find the newest checkpoint in a folder that can be read; None where there is none at all.

    Raises:
        UserError: there are checkpoints, and none can be read.
    """
    there = [path for path in (Path(folder) / name for name in (LAST, PREVIOUS)) if path.exists()]
    for path in there:
        try:
            read_checkpoint(path)
        except UserError:
            continue
        return path
    if there:
        names = " and ".join(map(str, there))
        raise UserError(f"{names} cannot be read, and the run cannot go on: delete {folder} to start from scratch.")
    return None


def drop_damaged(whole: Path) -> None:
    """Remove a newer checkpoint than the one that a run goes on from: `newest_whole` found it damaged.

    It would otherwise step aside for the next one and replace the whole one.
    """
    newer = whole.with_name(LAST)
    if whole.name != LAST and newer.exists():
        log.warning("%s is damaged: going on from %s, the one before.", printable(str(newer)), whole.name)
        newer.unlink()


def _save(checkpoint: dict[str, Any], file: Any) -> None:
    """`torch.save`, whose writer hides what the disk said behind an error of its own."""
    try:
        torch.save(checkpoint, file)
    except RuntimeError as error:
        if isinstance(error.__context__, OSError):
            raise error.__context__ from None
        raise
