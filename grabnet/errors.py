"""The one error that a user is meant to read."""

from __future__ import annotations


class UserError(ValueError):
    """Bad input, reported in one sentence that names the file, the value and the remedy.

    Commands print it without a traceback and exit with code 2, or 1 where the rest was done; any other exception is a
    bug of ours.
    """
