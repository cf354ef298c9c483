"""Loggers that `configs/logger` names besides Lightning's own."""

from __future__ import annotations

from typing import Any

from lightning.pytorch.loggers import WandbLogger

from grabnet.errors import UserError


def wandb_logger(**options: Any) -> WandbLogger:
    """Make Lightning's logger for wandb.

    Raises:
        UserError: wandb is not installed.
    """
    try:
        return WandbLogger(**options)
    except ModuleNotFoundError:
        raise UserError("logger=wandb needs wandb: pip install -e '.[wandb]'.") from None
