"""Running warp kernels on torch tensors, on the CPU or an NVIDIA GPU, whichever holds them.

warp takes half a second to start and compiles a module of kernels at first use (seconds; kept in its own cache).
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import torch
import warp as wp
from torch import Tensor

# Fewer items than this per thread are not worth a thread.
_ITEMS_PER_THREAD = 20_000


@contextmanager
def _silent_stderr() -> Iterator[None]:
    """Hide what native code writes to stderr, which no Python setting reaches."""
    saved, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(nowhere)


wp.config.log_level = wp.LOG_WARNING
with _silent_stderr():  # on a machine without an NVIDIA driver warp says so at every start
    wp.init()


def launch(kernel: wp.Kernel, items: Sequence[Tensor], constants: Sequence[Any], dims: int = 1) -> None:
    """Run `kernel(*constants, *items)` once for each item.

    Args:
        items: contiguous tensors whose first `dims` dimensions number the items; a trailing 3 becomes a `vec3`. Tensors
            with fewer dimensions hold one entry per row of items. The kernel writes into those that are its outputs.
        constants: what all items share: numbers, warp arrays, mesh ids.
        dims: 1 or 2. The first dimension is shared out between threads on a CPU.
    """
    first = items[0]
    shape = first.shape[:dims]
    device = wp.device_from_torch(first.device)
    kernel.module.load(device)  # compiled before threads could race for it

    def run(rows: slice) -> None:
        arrays = [_as_warp(x[rows], dims) for x in items]
        size = (len(range(*rows.indices(shape[0]))), *shape[1:])
        wp.launch(kernel, size, [*constants, *arrays], device=device)

    if device.is_cuda:
        # Queued behind the torch work that made the inputs, and before what will read the outputs.
        with wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(first.device))):
            return run(slice(None))
    threads = max(1, min(torch.get_num_threads(), shape.numel() // _ITEMS_PER_THREAD, shape[0]))
    if threads == 1:
        return run(slice(None))
    edges = [shape[0] * i // threads for i in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:  # warp releases the interpreter lock while a kernel runs
        list(pool.map(run, [slice(a, b) for a, b in pairwise(edges)]))


def shared(tensor: Tensor, dtype: Any = None) -> wp.array:
    """A tensor as a warp array for all items to read; they share memory."""
    return wp.from_torch(tensor, dtype=dtype)


def _as_warp(tensor: Tensor, dims: int) -> wp.array:
    return wp.from_torch(tensor, dtype=wp.vec3 if tensor.dim() > dims and tensor.shape[-1] == 3 else None)
