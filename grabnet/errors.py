"""The one error that a user is meant to read, and what is said of any other."""

from __future__ import annotations

from pathlib import Path
from traceback import extract_tb


class UserError(ValueError):
    """Bad input, reported in one sentence that names the file, the value and the remedy.

    Commands print it without a traceback and exit with code 2, or 1 where the rest was done; any other exception is a
    bug of ours.
    """


def unexpected(file: str | Path, error: Exception) -> str:
    """The sentence of an error in the work on a file that nothing foresaw."""
    place = next((f" in {Path(at.filename).name}:{at.lineno}" for at in reversed(extract_tb(error.__traceback__))), "")
    what = "".join(c if c.isprintable() else " " for c in f"{type(error).__name__}: {error}"[:200])
    return f"{file} met an unexpected error ({what}{place}): it is a fault of grabnet; report it there, with the file."
