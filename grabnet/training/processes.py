"""Training in several processes, one per device: who starts them, who writes."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import lightning as L
import torch.distributed as dist
from lightning.fabric.plugins.environments import LightningEnvironment, SLURMEnvironment, TorchElasticEnvironment

from grabnet.errors import UserError

log = logging.getLogger(__name__)

# Seconds that a process gets to fail by itself where another one has: a broken connection says so at once, but who
# waits for a connection or on a GPU waits for many minutes.
_GRACE = 15


def started_from_outside() -> bool:
    """Whether `srun` or `torchrun` starts the processes, one per device, with the user's whole command each."""
    tasks = int(os.environ.get("SLURM_NTASKS", 1)) if SLURMEnvironment.detect() else 1
    return tasks > 1 or TorchElasticEnvironment.detect()


class OwnProcesses(LightningEnvironment):
    """The processes of a run on one machine, which the first of them, the user's, starts itself.

    Lightning would give each the user's command line: a sweep would begin anew in each of them, and `${now:…}` would
    be another folder. Here they read the config that the first one wrote.
    """

    @property
    def creates_processes_externally(self) -> bool:
        return True  # not by Lightning

    def start(self, n: int, module: str, config: Path) -> list[subprocess.Popen]:
        """Start the n - 1 others, `python -m <module> <config>` each. They print nothing but errors."""
        shared = os.environ | {"MASTER_ADDR": self.main_address, "MASTER_PORT": str(self.main_port)}
        command = [sys.executable, "-m", module, str(config)]
        return [
            subprocess.Popen(command, env=shared | {"LOCAL_RANK": str(rank)}, stdout=subprocess.DEVNULL)
            for rank in range(1, n)
        ]


@contextmanager
def together(trainer: L.Trainer, module: str, config: Path) -> Iterator[None]:
    """Run the block in all processes of a trainer: each waits at its start for the first one.

    That one comes here when all that the others read has been written. Does nothing where there is but one.

    Args:
        trainer: made with `OwnProcesses` among its plugins unless the processes were started from outside.
        module: what takes part in a run as `python -m <module> <config>`.
        config: file of the run's config.

    Raises:
        UserError: processes on several machines, but none of them started from outside; or started from outside for
            run folders of different names.
    """
    if trainer.world_size == 1:
        yield
        return
    environment = trainer.strategy.cluster_environment
    own = isinstance(environment, OwnProcesses)
    if own and trainer.num_nodes > 1:
        raise UserError(f"trainer.num_nodes={trainer.num_nodes} needs srun or torchrun to start the processes.")
    others = environment.start(trainer.num_devices, module, config) if own and trainer.is_global_zero else []
    over = threading.Event()
    threading.Thread(target=_watch, args=(others, over), daemon=True).start()
    try:
        trainer.strategy.setup_environment()
        if (first := Path(trainer.strategy.broadcast(str(config)))) != config:
            raise UserError(f"Processes write to {first.parent} and {config.parent}: name the folder with run_dir=….")
        yield
        dist.destroy_process_group()
        for process in others:
            process.wait()
    finally:
        over.set()
        for process in others:
            process.kill()
        if dist.is_initialized():
            dist.destroy_process_group()
        if own:  # a sweep's next run finds a free port of its own
            for name in ("MASTER_ADDR", "MASTER_PORT"):
                os.environ.pop(name, None)


def _watch(others: list[subprocess.Popen], over: threading.Event) -> None:
    """End this process where another one failed and it would wait for that one in vain."""
    while not over.wait(1):
        if (failed := [process.returncode for process in others if process.poll()]) and not over.wait(_GRACE):
            log.error("A process of the run ended with code %d; what it said is above.", failed[0])
            for process in others:
                process.kill()
            os._exit(1)
