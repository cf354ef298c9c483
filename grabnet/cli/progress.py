"""Progress of what takes long, and the time left: bars on a terminal, elsewhere a line now and then; both on stderr.

Only commands show it (`shown`): code that is called from Python, and worker processes, stay silent.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterable, Iterator, Sized
from contextlib import contextmanager, nullcontext
from typing import TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from grabnet.errors import printable

Item = TypeVar("Item")

# Seconds until the first line, and from one to the next.
_FIRST, _EVERY = 5.0, 30.0
# Seconds over which speed is measured: steps may take minutes.
_PERIOD = 3600.0

_display: _Display | None = None


class Steps:
    """Steps of one piece of work.

    Args:
        display: where they are shown; None for nowhere.
        what: is done, as in "Measuring grasps".
        total: number of steps; None where nobody knows.
        done: of these already.
    """

    def __init__(self, display: _Display | None, what: str, total: float | None, done: float):
        self._progress = display.progress if display is not None else None
        if self._progress is not None:
            self._task = self._progress.add_task(printable(what), total=total, completed=done, start=True, about="")

    def advance(self, n: float = 1, about: str | None = None) -> None:
        """Count n further steps.

        Args:
            about: what stands behind the numbers from now on, such as the step's name; as before when omitted.
        """
        if self._progress is not None:
            self._progress.update(self._task, advance=n, **({} if about is None else {"about": printable(about)}))

    def _end(self) -> None:
        if self._progress is not None:
            self._progress.remove_task(self._task)


@contextmanager
def steps(what: str, total: float | None, done: float = 0) -> Iterator[Steps]:
    """Show the steps that the block counts; arguments as of `Steps`."""
    made = Steps(_display, what, total, done)
    try:
        yield made
    finally:
        made._end()


def track(items: Iterable[Item], what: str, total: float | None = None) -> Iterator[Item]:
    """Yield items, each a step.

    Args:
        items: of any kind.
        what: is done with them, as in "Drawing grasps".
        total: how many there are, where `items` does not say.
    """
    with steps(what, len(items) if total is None and isinstance(items, Sized) else total) as counted:
        for item in items:
            yield item
            counted.advance()


@contextmanager
def shown(quiet: bool = False) -> Iterator[None]:
    """Show what the block does, and all that it calls in this process.

    Args:
        quiet: show nothing.
    """
    global _display
    before, _display = _display, None if quiet else _Display()
    try:
        with _display or nullcontext():
            yield
    finally:
        _display = before


class _Display:
    """Bars that refresh themselves, or a thread that writes lines; within `with`."""

    def __init__(self):
        console = Console(stderr=True, soft_wrap=True)
        self._has_bars = console.is_terminal and not console.is_dumb_terminal
        self.progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left:"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[about]}", markup=False),
            console=console,
            transient=True,
            redirect_stdout=sys.stdout.isatty(),  # what is printed there belongs to a pipe otherwise
            disable=not self._has_bars,
            speed_estimate_period=_PERIOD,
        )
        self._ended = threading.Event()

    def __enter__(self) -> None:
        if self._has_bars:
            self.progress.start()
        else:
            threading.Thread(target=self._write_lines, daemon=True).start()

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self.progress.stop()

    def _write_lines(self) -> None:
        wait = _FIRST
        while not self._ended.wait(wait):
            wait = _EVERY
            for task in self.progress.tasks:
                try:
                    print(line(task), file=sys.stderr, flush=True)
                except (OSError, ValueError):  # nobody reads them any more
                    return


def line(task: Task) -> str:
    """How far a task has come: "Drawing grasps: 3 of 20, 1 min 5 s left (mug)"."""
    total = "" if task.total is None else f" of {task.total:g}"
    left = "" if task.time_remaining is None else f", {duration(task.time_remaining)} left"
    about = f" ({task.fields['about']})" if task.fields["about"] else ""
    return f"{task.description}: {task.completed:g}{total}{left}{about}"


def duration(seconds: float) -> str:
    """Seconds in the two largest units of h, min and s: "2 h 5 min"."""
    minutes, s = divmod(round(seconds), 60)
    h, minutes = divmod(minutes, 60)
    parts = [(h, "h"), (minutes, "min"), (s, "s")]
    first = next((i for i, (n, _) in enumerate(parts) if n), 2)
    return " ".join(f"{n} {unit}" for n, unit in parts[first : first + 2] if n) or "0 s"
