"""Work that some of its workers don't survive."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from pathlib import Path

from grabnet.preprocess.backends import Outcome


@dataclass(frozen=True)
class Dying:
    """Leaves a mark for each name, and dies of names that begin with "die": ever, or for "die once" the first time."""

    folder: Path

    def __call__(self, name: str) -> Outcome:
        marks = list(self.folder.glob(f"{name}.*"))
        (self.folder / f"{name}.{len(marks)}").touch()
        if name.startswith("die") and not (marks and "once" in name):
            os.kill(os.getpid(), signal.SIGKILL)
        return Outcome(name, None)
