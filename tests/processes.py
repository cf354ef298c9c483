"""Commands of this repository in processes that can be killed and limited, forked from one that has the slow imports
behind it."""

from __future__ import annotations

import multiprocessing
import os
import resource
import runpy
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.context import ForkServerProcess
from pathlib import Path

ROOT = Path(__file__).parents[1]
FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(
    ["grabnet.training_run", "grabnet.sweeps.report", "grabnet.sweeps.pruning", "grabnet.preprocess.pipeline"]
)


def start(
    arguments: list[str], output: Path, max_file_bytes: int | None = None, script: str = "train.py"
) -> ForkServerProcess:
    """Begin `python <script> <arguments>`, all that it prints going to the end of a file.

    Args:
        max_file_bytes: at which writing to any file fails, as on a full disk.
    """
    process = FORKS.Process(target=_command, args=(arguments, output, max_file_bytes, script))
    process.start()
    return process


def finish(arguments: list[str], output: Path, max_file_bytes: int | None = None, script: str = "train.py") -> int:
    """The exit code of `python <script> <arguments>`."""
    process = start(arguments, output, max_file_bytes, script)
    process.join()
    assert process.exitcode is not None
    return process.exitcode


@contextmanager
def files_of_at_most(n_bytes: int) -> Iterator[None]:
    """Writing more to any file fails in this process, as on a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def _command(arguments: list[str], output: Path, max_file_bytes: int | None, script: str) -> None:
    os.chdir(ROOT)
    with output.open("a") as file:
        os.dup2(file.fileno(), sys.stdout.fileno())
        os.dup2(file.fileno(), sys.stderr.fileno())
    if max_file_bytes is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (max_file_bytes, max_file_bytes))
    sys.argv = [script, *arguments]
    runpy.run_path(script, run_name="__main__")
