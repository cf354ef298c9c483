"""What makes the same network faster on hardware that offers it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import nn

from grabnet.errors import UserError
from grabnet.models.layers import ResidualBlock

PRECISIONS = ("highest", "high", "medium")
_KINDS_OF_INPUT = 8  # of one residual block: in training and outside it, each for some numbers of rows and then for any


def set_matmul_precision(precision: str) -> None:
    """How exactly this process multiplies float32 matrices from now on: "highest", "high" or "medium".

    Raises:
        UserError: another value.
    """
    if precision not in PRECISIONS:
        raise UserError(f"matmul_precision is '{precision}'; it can be {', '.join(PRECISIONS)}.")
    torch.set_float32_matmul_precision(precision)


@contextmanager
def denormals_flushed() -> Iterator[None]:
    """Have this thread, and those that torch starts meanwhile, take numbers below 1.2e-38 for zero.

    Weight decay brings weights that a network does not need down to such numbers, with which a CPU computes in
    microcode: a layer that has only these takes two hundred times as long. Threads stay as they were started, so
    this helps them all where torch has not computed anything yet.
    """
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


def compile_blocks(network: nn.Module) -> None:
    """Have torch.compile fuse the network's residual blocks, each when it is first used.

    In place: names and values of the weights stay. Not the network as a whole, since kernels that torch does not see
    into measure the hand between RefineNet's iterations. torch's limit on how often it compiles one function is raised
    to what all blocks need, since they share theirs and would run uncompiled beyond it.
    """
    blocks = [block for block in network.modules() if isinstance(block, ResidualBlock)]
    torch._dynamo.config.recompile_limit = max(torch._dynamo.config.recompile_limit, _KINDS_OF_INPUT * len(blocks))
    for block in blocks:
        block.compile()
