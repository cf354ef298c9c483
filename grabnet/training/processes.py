"""Training in several processes, one per device: who starts them, who writes."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NoReturn

import lightning as L
import torch.distributed as dist
from lightning.fabric.plugins.environments import LightningEnvironment, SLURMEnvironment, TorchElasticEnvironment

from grabnet.cli.ends import say
from grabnet.errors import UserError

# Seconds that a process gets to fail by itself where another one has: a broken connection says so at once, but who
# waits for a connection or on a GPU waits for many minutes.
_GRACE = 15
# Seconds without a sign of life after which a process counts as stopped: the others would wait for it without end.
SILENCE = 60
_BEAT = 1.0  # seconds between two signs
_START = 600  # seconds until the first one, at most: a process imports and reads the config before


def started_from_outside() -> bool:
    """Whether `srun` or `torchrun` starts the processes, one per device, with the user's whole command each."""
    tasks = int(os.environ.get("SLURM_NTASKS", 1)) if SLURMEnvironment.detect() else 1
    return tasks > 1 or TorchElasticEnvironment.detect()


class OwnProcesses(LightningEnvironment):
    """The processes of a run on one machine, which the first of them, the user's, starts itself.

    Lightning would give each the user's command line: a sweep would begin again in each of them, and `${now:…}` would
    be another folder. Here they read the config that the first one wrote.
    """

    @property
    def creates_processes_externally(self) -> bool:
        return True  # not by Lightning

    def start(self, n: int, module: str, config: Path) -> list[subprocess.Popen]:
        """Start the n - 1 others, `python -m <module> <config>` each. They print nothing but errors."""
        shared = os.environ | {"MASTER_ADDR": self.main_address, "MASTER_PORT": str(self.main_port)}
        command = [sys.executable, "-m", module, str(config)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}  # for signs of life
        return [
            subprocess.Popen(command, env=shared | {"LOCAL_RANK": str(rank)}, **pipes, bufsize=0)
            for rank in range(1, n)
        ]


class Lifeline:
    """Signs of life between this process and another one, over a pair of pipes, in threads of their own.

    Args:
        read, write: file descriptors.

    Attributes:
        heard: when there was a sign last, by the monotonic clock; until the first one, when that is due.
        closed: whether the other process has gone.
    """

    def __init__(self, read: int, write: int):
        self._read, self._write = read, write
        self.heard, self.closed = time.monotonic() + _START, False
        threading.Thread(target=self._listen, daemon=True).start()
        threading.Thread(target=self._speak, daemon=True).start()

    def _listen(self) -> None:
        with suppress(OSError):
            while os.read(self._read, 4096):
                self.heard = time.monotonic()
        self.closed = True

    def _speak(self) -> None:
        with suppress(OSError):  # where nobody reads any more
            while True:
                os.write(self._write, b".")
                time.sleep(_BEAT)


def lifeline_of_child() -> Lifeline:
    """Of a process that `OwnProcesses` started, to the one that did. What it prints on stdout is lost."""
    silent = os.open(os.devnull, os.O_WRONLY)
    write = os.dup(1)
    os.dup2(silent, 1)
    return Lifeline(0, write)


@contextmanager
def together(trainer: L.Trainer, module: str, config: Path) -> Iterator[None]:
    """Run the block in all processes of a trainer: each waits at its start for the first one.

    That one comes here when all that the others read has been written. Does nothing where there is but one.

    Args:
        trainer: made with `OwnProcesses` among its plugins unless the processes were started from outside.
        module: what takes part in a run as `python -m <module> <config>`.
        config: file of the run's config.

    A process that fails, or gives no sign of life for `SILENCE` seconds, ends the others of its machine.

    Raises:
        UserError: processes on several machines, but none of them started from outside; or started from outside for
            run folders of different names; or another process failed.
    """
    if trainer.world_size == 1:
        yield
        return
    environment = trainer.strategy.cluster_environment
    own = isinstance(environment, OwnProcesses)
    if own and trainer.num_nodes > 1:
        raise UserError(f"trainer.num_nodes={trainer.num_nodes} needs srun or torchrun to start the processes.")
    others = environment.start(trainer.num_devices, module, config) if own and trainer.is_global_zero else []
    lines = [Lifeline(p.stdout.fileno(), p.stdin.fileno()) for p in others]
    if own and not trainer.is_global_zero:
        lines = [lifeline_of_child()]
    over = threading.Event()
    threading.Thread(target=_watch, args=(others, lines, over), daemon=True).start()
    try:
        trainer.strategy.setup_environment()
        if (first := Path(trainer.strategy.broadcast(str(config)))) != config:
            raise UserError(f"Processes write to {first.parent} and {config.parent}: name the folder with run_dir=….")
        yield
        dist.destroy_process_group()
        for process in others:
            process.wait()
    except RuntimeError as error:
        if not _is_of_connection(error):
            raise
        raise UserError(_why(others)) from None
    finally:
        over.set()
        for process in others:
            process.kill()
        if dist.is_initialized():
            dist.destroy_process_group()
        if own:  # a sweep's next run finds a free port of its own
            for name in ("MASTER_ADDR", "MASTER_PORT"):
                os.environ.pop(name, None)


def _watch(
    others: list[subprocess.Popen], lines: list[Lifeline], over: threading.Event, silence: float = SILENCE
) -> None:
    """End this process where another one is gone, for which it would wait in vain; `over` tells that all is done."""
    awake = time.monotonic()
    while not over.wait(_BEAT):
        slept, awake = time.monotonic() - awake > 5 * _BEAT, time.monotonic()
        for line in lines:
            if slept:  # stopped itself, as by Ctrl-Z: what the others said meanwhile is read next
                line.heard = max(line.heard, awake)
        failed = any(process.poll() for process in others) or (not others and any(line.closed for line in lines))
        if failed and not over.wait(_GRACE):
            _end(others, _why(others))
        if any(awake - line.heard > silence for line in lines if not line.closed) and not over.is_set():
            _end(others, f"A process of the run gave no sign of life for {silence:g} s: the run cannot go on.")


def _end(others: list[subprocess.Popen], sentence: str) -> NoReturn:
    """Leave from a thread, without waiting for the main one, which torch may hold for good."""
    say(sentence)
    for process in others:
        process.kill()
    os._exit(2)


def _is_of_connection(error: RuntimeError) -> bool:
    """Whether it is torch's, for a process that does not answer any more."""
    return isinstance(error, dist.DistError) or "gloo" in str(error)


def _why(others: list[subprocess.Popen]) -> str:
    """What became of the process that ended first, as far as this one knows."""
    deadline = time.monotonic() + _GRACE
    while not (codes := [p.returncode for p in others if p.poll()]) and others and time.monotonic() < deadline:
        time.sleep(0.1)
    if not codes:
        return "Another process of the run has gone: it cannot go on."
    return f"A process of the run ended with code {codes[0]}: the same command goes on from the last checkpoint."
