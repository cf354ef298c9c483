"""Folders that one process at a time writes to."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from grabnet.errors import UserError

LOCK = ".lock"  # stays in the folder; only who holds the system's lock on it writes there


@contextmanager
def alone_in(folder: Path, name: str) -> Iterator[None]:
    """Have a folder, which is made where it is not there, for this process alone.

    Args:
        name: of the config value that names it.

    Raises:
        UserError: another process has it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        lock = FileLock(folder / LOCK).acquire(timeout=0)
    except Timeout:
        raise UserError(f"Another run is at work on {folder}: wait for it, or choose another {name}.") from None
    with lock:
        yield
