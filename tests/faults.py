"""What befalls a process at a moment that a test chooses, however fast it runs: a kill, a full disk."""

from __future__ import annotations

import os
import resource
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatch
from itertools import count


def _die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@dataclass(frozen=True)
class DiesPublishing:
    """SIGKILL before the n-th file whose path is like `pattern` gets its name, so that its temporary file is left."""

    pattern: str
    n: int = 1

    def __call__(self) -> None:
        numbers = count(1)

        def watch(event: str, arguments: tuple) -> None:
            if event == "os.rename" and fnmatch(os.fspath(arguments[1]), self.pattern) and next(numbers) == self.n:
                _die()

        sys.addaudithook(watch)


@dataclass(frozen=True)
class DiesAtStep:
    """SIGKILL after the n-th optimiser step of the process."""

    n: int

    def __call__(self) -> None:
        from torch.optim.optimizer import register_optimizer_step_post_hook

        numbers = count(1)
        register_optimizer_step_post_hook(lambda *_: _die() if next(numbers) == self.n else None)


@dataclass(frozen=True)
class DiskIsFullAt:
    """Writing more than `n_bytes` to any file fails."""

    n_bytes: int

    def __call__(self) -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (self.n_bytes, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))


@contextmanager
def files_of_at_most(n_bytes: int) -> Iterator[None]:
    """`DiskIsFullAt` in this process, for a while."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    DiskIsFullAt(n_bytes)()
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
