"""Commands of this repository in processes that can be killed and limited, forked from one that has the slow imports
behind it."""

from __future__ import annotations

import multiprocessing
import os
import runpy
import sys
from collections.abc import Callable
from multiprocessing.context import ForkServerProcess
from pathlib import Path

ROOT = Path(__file__).parents[1]
FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(
    ["grabnet.training.run", "grabnet.sweeps.report", "grabnet.sweeps.pruning", "grabnet.preprocess.run"]
)


def start(
    arguments: list[str],
    output: Path,
    fault: Callable[[], None] | None = None,
    script: str = "train.py",
    folder: Path = ROOT,
) -> ForkServerProcess:
    """Begin `python <script> <arguments>`, all that it prints going to the end of a file.

    Args:
        fault: called in the process before the script: one of `tests.faults`.
        script: its path from the repository.
        folder: where the command is typed.
    """
    process = FORKS.Process(target=_command, args=(arguments, output, fault, script, folder))
    process.start()
    return process


def finish(
    arguments: list[str],
    output: Path,
    fault: Callable[[], None] | None = None,
    script: str = "train.py",
    folder: Path = ROOT,
) -> int:
    """The exit code of `python <script> <arguments>`, -9 where SIGKILL ended it; arguments as in `start`."""
    process = start(arguments, output, fault, script, folder)
    process.join()
    assert process.exitcode is not None
    return process.exitcode


def _command(arguments: list[str], output: Path, fault: Callable[[], None] | None, script: str, folder: Path) -> None:
    os.chdir(folder)
    with output.open("a") as file:
        os.dup2(file.fileno(), sys.stdout.fileno())
        os.dup2(file.fileno(), sys.stderr.fileno())
    if fault is not None:
        fault()
    sys.argv = [script, *arguments]
    runpy.run_path(str(ROOT / script), run_name="__main__")
