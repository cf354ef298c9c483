"""The runs of a sweep: each a folder that says what became of it."""

from __future__ import annotations

import hashlib
import logging
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra.core.utils import JobReturn, JobStatus
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig

from grabnet.errors import UserError, printable
from grabnet.io.files import write_json
from grabnet.io.state import read_json
from grabnet.training.ending import METRICS, RunPruned

OUTCOME = "outcome.json"
_REMEDY = "delete it, and the same command does that run again"
DONE, PRUNED, FAILED, UNFINISHED = "done", "pruned", "failed", "unfinished"

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Run:
    """One run of a sweep.

    Attributes:
        folder: all that it writes.
        overrides: the command line that makes it, without its folder.
        values: the swept ones among them, as strings by key.
    """

    folder: Path
    overrides: tuple[str, ...]
    values: Mapping[str, str]

    @property
    def status(self) -> str:
        """done, pruned, failed, or unfinished: not started, going on or killed."""
        if (self.folder / METRICS).exists():
            return DONE
        return self._outcome().get("status", UNFINISHED)

    @property
    def reason(self) -> str:
        """Why it was pruned or failed, in a sentence; otherwise empty."""
        return "" if self.status == DONE else self._outcome().get("reason", "")

    @property
    def settled(self) -> bool:
        """Whether there is nothing left to do: done or pruned."""
        return self.status in (DONE, PRUNED)

    def metrics(self) -> dict[str, float]:
        """Those of its best epoch, and its test errors. Only for a run that is done.

        Raises:
            UserError: a damaged file.
        """
        return read_json(self.folder / METRICS, {str: float}, _REMEDY)

    def _outcome(self) -> dict[str, str]:
        path = self.folder / OUTCOME
        return read_json(path, {"status": {PRUNED, FAILED}, "reason": str}, _REMEDY) if path.exists() else {}


def folder_name(overrides: Iterable[str], values: Mapping[str, str]) -> str:
    """A name that the same overrides, in any order, always get and no others: the swept values, then a hash of all."""
    # Where the sweep lies does not make it another one.
    given = sorted(o for o in overrides if not o.startswith("sweep_dir="))
    digest = hashlib.sha256("\n".join(given).encode()).hexdigest()[:6]
    readable = ",".join(f"{key.lstrip('+')}={value}" for key, value in values.items())
    return "-".join(part for part in (re.sub(r"[^\w.,=+-]", "_", readable)[:120], digest) if part)


class RecordOutcome(Callback):
    """Hydra callback that writes `outcome.json` where a run of a sweep is pruned or fails, in that run's process."""

    def on_job_start(self, config: DictConfig, **kwargs: Any) -> None:
        (Path(config.hydra.runtime.output_dir) / OUTCOME).unlink(missing_ok=True)  # of an earlier attempt

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **kwargs: Any) -> None:
        if config.hydra.mode != RunMode.MULTIRUN or job_return.status == JobStatus.COMPLETED:
            return
        folder = Path(config.hydra.runtime.output_dir)
        error = job_return._return_value  # its public twin would raise it
        if isinstance(error, RunPruned):
            status, reason = PRUNED, str(error)
            log.info("%s pruned: %s", printable(str(folder)), reason)
        elif isinstance(error, UserError):
            status, reason = FAILED, str(error)
            log.error("%s failed: %s", folder, reason)
        else:
            status, reason = FAILED, f"{type(error).__name__}: {error}"
            log.error("%s failed.", folder, exc_info=error)
        write_json(folder / OUTCOME, {"status": status, "reason": reason})
