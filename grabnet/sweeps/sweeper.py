"""What every sweep does: launch the runs that are not settled, outlive their failures, tell how all ended."""

from __future__ import annotations

import logging
import sys
from abc import abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.core.plugins import Plugins
from hydra.errors import HydraException
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

from grabnet.cli.ends import fail
from grabnet.errors import UserError, printable
from grabnet.sweeps.runs import FAILED, UNFINISHED, Run

log = logging.getLogger(__name__)


class RunSweeper(Sweeper):
    """Base of the sweepers in `hydra_plugins`.

    Args:
        params: swept values besides those of the command line, by key, in Hydra's grammar.
    """

    def __init__(self, params: dict[str, str] | None = None):
        self.params = params or {}
        self.launched = 0

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        self.config, self.hydra_context = config, hydra_context
        self.launcher = Plugins.instance().instantiate_launcher(
            hydra_context=hydra_context, task_function=task_function, config=config
        )

    @property
    def folder(self) -> Path:
        """Of the sweep; its runs' folders lie in it."""
        return Path(self.config.hydra.sweep.dir)

    def sweep(self, arguments: list[str]) -> None:
        """Run all, then print and save the table; the exit code is 1 where a run failed or was not finished."""
        from grabnet.sweeps.report import report  # matplotlib is slow to import: not before the runs

        lines = [*(f"{key}={value}" for key, value in self.params.items()), *arguments]
        try:
            parser = OverridesParser.create(config_loader=self.hydra_context.config_loader)
            last_word = {o.get_key_element(): o for o in parser.parse_overrides(lines)}
            runs = self.run_all(list(last_word.values()))
            if not runs:
                raise UserError("There is nothing to run: a swept key has no values.")
        except UserError as error:
            fail(error)
        except HydraException as error:
            fail(UserError(" ".join(str(error).split())))
        report(runs, self.config.objective, self.folder)
        if any(run.status in (FAILED, UNFINISHED) for run in runs):
            sys.exit(1)

    @abstractmethod
    def run_all(self, overrides: list[Override]) -> list[Run]:
        """Launch all runs, and return them."""

    def launch(self, runs: Sequence[Run]) -> None:
        """Launch those that are not settled, and wait for them."""
        waiting = [run for run in runs if not run.settled]
        if settled := len(runs) - len(waiting):
            log.info("%d of %d runs are complete in %s.", settled, len(runs), printable(str(self.folder)))
        if not waiting:
            return
        jobs: Any = [[*run.overrides, f"hydra.sweep.subdir='{run.folder.name}'"] for run in waiting]
        try:
            self.launcher.launch(jobs, initial_job_idx=self.launched)
        except Exception:  # a process that died without a word, of which the launcher makes an error
            log.exception("Not all runs came back; the same command goes on with them.")
        self.launched += len(waiting)


def fixed(overrides: Sequence[Override]) -> list[str]:
    """Those that are the same in all runs, as on the command line."""
    return [o.input_line for o in overrides if not o.is_sweep_override()]
