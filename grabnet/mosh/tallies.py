"""How far workers have come within their captures, in small files that the run adds up.

Files serve processes of this machine and of a cluster alike: both see the folder that is written.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from grabnet.cli.progress import Steps

_EVERY = 0.5  # seconds between two looks, and between two writes


class Tally:
    """Frames done of one capture; its file is written now and then."""

    def __init__(self, root: Path, name: str):
        self._path, self._done, self._written = _path(root, name), 0.0, 0.0

    def add(self, frames: float) -> None:
        """Count further frames, or shares of them."""
        self._done += frames
        if time.monotonic() - self._written > _EVERY:
            self._written = time.monotonic()
            with suppress(OSError):
                self._path.parent.mkdir(parents=True, exist_ok=True)
                self._path.write_text(f"{self._done:.0f}")


@contextmanager
def followed(root: Path, frames: Mapping[str, int], counted: Steps) -> Iterator[Callable[[str], None]]:
    """Show what the tallies below `root` count while the block runs.

    Args:
        root: of the data set.
        frames: about how many each capture has that is worked on.
        counted: shows it; a step is a frame.

    Yields:
        what to call with the name of a capture that has ended: its frames count as done.
    """
    began, ended, lock, over = time.monotonic(), set[str](), threading.Lock(), threading.Event()
    shown = 0.0

    def look(name: str | None = None) -> None:
        nonlocal shown
        with lock:
            if name is not None:
                ended.add(name)
                _path(root, name).unlink(missing_ok=True)
            done = sum(n if name in ended else min(n, _read(root, name)) for name, n in frames.items())
            if done > shown:
                rate = done / max(time.monotonic() - began, 1e-9)
                counted.advance(done - shown, f"{rate:.0f} frames/s, {len(ended)} of {len(frames)} captures")
                shown = done

    def keep_looking() -> None:
        while not over.wait(_EVERY):
            look()

    for name in frames:
        _path(root, name).unlink(missing_ok=True)  # of a run that was killed
    thread = threading.Thread(target=keep_looking, daemon=True)
    thread.start()
    try:
        yield look
    finally:
        over.set()
        thread.join()


def _read(root: Path, name: str) -> float:
    try:
        return float(_path(root, name).read_text())
    except (OSError, ValueError):  # none yet, or half written
        return 0.0


def _path(root: Path, name: str) -> Path:
    return root / "mosh" / f"{name}.tally"
