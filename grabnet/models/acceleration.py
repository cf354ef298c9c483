"""What makes the same network faster on hardware that offers it."""

from __future__ import annotations

import torch
from torch import nn

from grabnet.errors import UserError
from grabnet.models.layers import ResidualBlock

PRECISIONS = ("highest", "high", "medium")


def set_matmul_precision(precision: str) -> None:
    """How exactly this process multiplies float32 matrices from now on: "highest", "high" or "medium".

    Raises:
        UserError: another value.
    """
    if precision not in PRECISIONS:
        raise UserError(f"matmul_precision is '{precision}'; it can be {', '.join(PRECISIONS)}.")
    torch.set_float32_matmul_precision(precision)


def compile_blocks(network: nn.Module) -> None:
    """Have torch.compile fuse the network's residual blocks, each when it is first used.

    In place: names and values of the weights stay. Not the network as a whole, since kernels that torch does not see
    into measure the hand between RefineNet's iterations.
    """
    for block in network.modules():
        if isinstance(block, ResidualBlock):
            block.compile()
