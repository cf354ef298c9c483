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


def launch(kernel: wp.Kernel, items: Sequence[Tensor], constants: Sequence[Any]) -> None:
    """Run `kernel(*constants, *items)` once for each item; on a CPU in as many threads as torch uses.

    Args:
        items: contiguous tensors (N,), or (N, 3) and (N, 4) for vectors; the kernel writes into those it changes.
        constants: what all items share: numbers, warp arrays, mesh ids.
    """
    first = items[0]
    device = wp.device_from_torch(first.device)
    kernel.module.load(device)  # compiled before threads could race for it

    def run(rows: slice) -> None:
        arrays = [_as_warp(x[rows]) for x in items]
        wp.launch(kernel, arrays[0].shape[0], [*constants, *arrays], device=device)

    if device.is_cuda:
        # Queued behind the torch work that made the inputs, and before what will read the outputs.
        with wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(first.device))):
            return run(slice(None))
    threads = max(1, min(torch.get_num_threads(), len(first) // _ITEMS_PER_THREAD))
    if threads == 1:
        return run(slice(None))
    edges = [len(first) * i // threads for i in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:  # warp releases the interpreter lock while a kernel runs
        list(pool.map(run, [slice(a, b) for a, b in pairwise(edges)]))


def shared(tensor: Tensor, dtype: Any = None) -> wp.array:
    """A tensor as a warp array for all items to read; they share memory."""
    return wp.from_torch(tensor, dtype=dtype)


def _as_warp(tensor: Tensor) -> wp.array:
    if tensor.dim() == 1:
        return wp.from_torch(tensor)
    vectors = {torch.float32: {3: wp.vec3, 4: wp.vec4}, torch.int32: {3: wp.vec3i}}
    return wp.from_torch(tensor, dtype=vectors[tensor.dtype][tensor.shape[1]])
