"""Running warp kernels on torch tensors, on the CPU or an NVIDIA GPU, whichever holds them.

warp takes half a second to start and compiles a module of kernels at first use (seconds; kept in its own cache).
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
import warp as wp
from torch import Tensor

# Fewer items than this per thread are not worth a thread.
_ITEMS_PER_THREAD = 4_000
# On a GPU so many threads share a row.
_LANES = 256


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


def _user_cache() -> Path:
    """Where warp's folder lies, unless WARP_CACHE_PATH names one."""
    return Path(os.environ.get("XDG_CACHE_HOME", os.path.expanduser("~")))  # noqa: PTH111, "~": there is no home


def _start_warp() -> None:
    """Start warp, with its kernels in a temporary folder where the user's cache cannot be written to."""
    wp.config.log_level = wp.LOG_WARNING
    usable = False
    named = os.environ.get("WARP_CACHE_PATH")
    if named or (named is None and _user_cache().is_absolute()):  # else it would lie in the current folder
        with suppress(OSError), _silent_stderr():  # on a machine without an NVIDIA driver warp says so at every start
            wp.init()
            usable = os.access(wp.config.kernel_cache_dir, os.W_OK)
    if usable:
        return
    folder = tempfile.mkdtemp(prefix="grabnet-kernels-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    warnings.warn(
        "The user's cache folder cannot be used: compiled kernels are kept in a temporary one. Name one that can "
        "in the environment, as WARP_CACHE_PATH and GRABNET_CACHE, to save half a minute at each start.",
        stacklevel=2,
    )
    os.environ["WARP_CACHE_PATH"] = wp.config.kernel_cache_dir = folder  # of processes that this one starts, too
    with _silent_stderr():
        wp.init()


_start_warp()


def launch(kernel: wp.Kernel, items: Sequence[Tensor], constants: Sequence[Any], width: int | None = None) -> None:
    """Run `kernel(*constants, *items)` once for each item; on a CPU in as many threads as torch uses.

    Args:
        items: contiguous tensors whose first dimension is the items'; the kernel writes into those it changes.
        constants: what all items share: numbers, tensors, warp structs, mesh ids.
        width: of each item, where an item is a row of work. The kernel's first argument is then the number of lanes,
            threads that share a row: many on a GPU, one on a CPU.
    """
    items = [x.detach() for x in items]  # pieces of what needs a gradient would need one in other threads
    first = items[0]
    device = wp.device_from_torch(first.device)
    kernel.module.load(device)  # compiled before threads could race for it
    lanes = [] if width is None else [min(width, _LANES) if device.is_cuda else 1]
    arguments = [a.type for a in kernel.adj.args]
    fixed = [*lanes, *map(_as_warp, constants, arguments[len(lanes) :])]

    def run(rows: slice) -> None:
        arrays = map(_as_warp, (x[rows] for x in items), arguments[len(fixed) :])
        wp.launch(kernel, [rows.stop - rows.start, *lanes], [*fixed, *arrays], device=device)

    if device.is_cuda:
        # Queued behind the torch work that made the inputs, and before what will read the outputs.
        with wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(first.device))):
            return run(slice(0, len(first)))
    work = len(first) * (1 if width is None else width)
    threads = max(1, min(torch.get_num_threads(), work // _ITEMS_PER_THREAD, len(first)))
    if threads == 1:
        return run(slice(0, len(first)))
    edges = [len(first) * i // threads for i in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:  # warp releases the interpreter lock while a kernel runs
        list(pool.map(run, [slice(a, b) for a, b in pairwise(edges)]))


def _as_warp(value: Any, declared: Any) -> Any:
    """A tensor as the array that the kernel declares, sharing its memory."""
    return wp.from_torch(value, dtype=declared.dtype) if isinstance(value, Tensor) else value
