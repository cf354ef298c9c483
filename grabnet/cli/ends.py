"""How a command ends: whatever stops it becomes one sentence on stderr and an exit code.

Nothing slow to import is used here, so that Ctrl-C is answered from the start.
"""

from __future__ import annotations

import errno
import logging
import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import NoReturn

from grabnet.errors import UserError, printable

_PACKAGE = Path(__file__).parents[1]
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_PIPE_CLOSED = 128 + 13  # as a shell counts SIGPIPE, which Windows does not have


class Stopped(BaseException):
    """Raised where the process is when it gets SIGINT (Ctrl-C) or SIGTERM.

    No `KeyboardInterrupt`, of which libraries make exit codes of their own.
    """

    def __init__(self, signum: int):
        self.signum = signum
        super().__init__(f"stopped by {signal.Signals(signum).name}{' (Ctrl-C)' * (signum == signal.SIGINT)}.")


@contextmanager
def in_sentences() -> Iterator[None]:
    """Run a command in the block: what it raises is printed in a sentence, and the process left with its exit code.

    Exit codes: 2 for `UserError`, for what the system refuses (`OSError`) and for faults of ours; 130 for SIGINT, 143
    for SIGTERM; 141, in silence, where the reader of a pipe has gone. With HYDRA_FULL_ERROR=1 in the environment faults
    of ours keep their traceback.
    """
    with _signals_raise():
        _take_any_character()
        logging.raiseExceptions = False  # a log that cannot be written is no reason for tracebacks
        try:
            yield
            sys.stdout.flush()  # while a full disk can still be reported
        except Stopped as stop:
            say(_with_notes(stop))
            sys.exit(128 + stop.signum)
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes it once more as it ends
            sys.exit(_PIPE_CLOSED)
        except Exception as error:
            mistake = as_user_error(error)
            if mistake is None and os.environ.get("HYDRA_FULL_ERROR") == "1":
                raise
            fail(mistake or UserError(unexpected(error)))


def fail(error: UserError) -> NoReturn:
    """Print the sentence and leave with exit code 2."""
    say(_with_notes(error))
    sys.exit(2)


def say(sentence: str) -> None:
    """Print "error: <sentence>" in a line of its own on stderr; what could steer the terminal is shown as its code."""
    line = " ".join(sentence.splitlines())
    print("error:", "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line), file=sys.stderr)


def note(line: str) -> None:
    """Print a line of results on stdout; what could steer the terminal, as in names of files, is shown as its code."""
    print(printable(line))


def as_user_error(error: BaseException) -> UserError | None:
    """An error that the user can do something about, in a sentence; None for a fault of ours."""
    if isinstance(error, UserError):
        return error
    if isinstance(error, MemoryError):
        return UserError(f"The memory does not suffice ({error or 'no more is to be had'}): ask for less at once.")
    if not isinstance(error, OSError) or error.errno is None:
        return None
    where = error.filename if error.filename is not None else "A file, the output or a connection"
    where, remedy = os.fsdecode(where) if isinstance(where, str | bytes) else str(where), "choose another place"
    if error.errno in _FULL:
        remedy = f"make room, or {remedy}"
    sentence = UserError(f"{where} cannot be used ({error.strerror or os.strerror(error.errno)}): {remedy}.")
    for note in getattr(error, "__notes__", ()):
        sentence.add_note(note)
    return sentence


def unexpected(error: BaseException) -> str:
    """A fault of ours, in a sentence that a report can quote."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if Path(f.filename).is_relative_to(_PACKAGE)]
    at = f" ({Path(frames[-1].filename).relative_to(_PACKAGE.parent)}, line {frames[-1].lineno})" if frames else ""
    reason = " ".join(str(error).split())
    return (
        f"Unexpected {type(error).__name__}{f': {reason}' if reason else ''}{at}. This is a fault of grabnet's: please "
        "report it with the command and its input."
    )


def _with_notes(error: BaseException) -> str:
    return " ".join([str(error), *getattr(error, "__notes__", ())])


@contextmanager
def _signals_raise() -> Iterator[None]:
    """Raise `Stopped` in the block for SIGINT and SIGTERM, unless they are ignored, as nohup has it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def stop(signum: int, frame: FrameType | None) -> None:
    """Signal handler: raise `Stopped`; the same signal once more ends the process at once."""
    signal.signal(signum, signal.SIG_DFL)
    raise Stopped(signum)


def _take_any_character() -> None:
    """Show what a terminal has no character for by its code, instead of ending."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
