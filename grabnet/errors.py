"""The one error that a user is meant to read."""

from __future__ import annotations


class UserError(ValueError):
    """Bad input, told in one sentence that names the file, the value and the remedy.

    Entry points print it without a traceback and exit with code 2; any other exception is a bug of ours.
    """
