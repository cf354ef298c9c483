"""Loggers that `configs/logger` names besides Lightning's own."""

from __future__ import annotations

import secrets
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from lightning.pytorch.loggers import WandbLogger
from lightning.pytorch.utilities import rank_zero_only

from grabnet.errors import UserError
from grabnet.io.files import replacing

ID = "wandb_id"  # in the run folder


def wandb_logger(save_dir: str, resume: bool, **options: Any) -> WandbLogger:
    """Make Lightning's logger for wandb.

    A run that goes on has the same id there, and those of a sweep are a group.

    Args:
        save_dir: the run folder.
        resume: whether the run goes on where one was started in its folder.
        options: of Lightning's logger.

    Raises:
        UserError: wandb is not installed.
    """
    try:
        return WandbLogger(
            save_dir=save_dir, id=_run_id(Path(save_dir) / ID, resume), group=_sweep(save_dir), **options
        )
    except ModuleNotFoundError:
        raise UserError("logger=wandb needs wandb: pip install -e '.[wandb]'.") from None


def _run_id(path: Path, resume: bool) -> str:
    """The id in the file, where there is one to go on with; otherwise a new one, which the first process writes."""
    if path.exists() and (resume or rank_zero_only.rank):
        return path.read_text(encoding="utf-8").strip()
    name = secrets.token_hex(4)
    if not rank_zero_only.rank:
        with replacing(path) as temporary:
            temporary.write_text(name, encoding="utf-8")
    return name


def _sweep(run_dir: str) -> str | None:
    """The name of the sweep whose run this is."""
    is_sweep = HydraConfig.initialized() and HydraConfig.get().mode == RunMode.MULTIRUN
    return Path(run_dir).absolute().parent.name if is_sweep else None
