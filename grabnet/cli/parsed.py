"""Commands that take their arguments from argparse."""

from __future__ import annotations

import argparse
from typing import Any

from grabnet.cli.entry import fail
from grabnet.cli.help import EXIT_CODES
from grabnet.cli.progress import shown
from grabnet.errors import UserError


class _Parser(argparse.ArgumentParser):
    """A parser with --quiet, also in its subparsers."""

    def __init__(self, *arguments: Any, **options: Any):
        super().__init__(*arguments, **options)
        self.add_argument("--quiet", action="store_true", default=argparse.SUPPRESS, help="show no progress")


def make_parser(about: str | None) -> argparse.ArgumentParser:
    """A parser whose help says what the command does and what its exit codes mean."""
    return _Parser(description=about, epilog=EXIT_CODES, formatter_class=argparse.RawDescriptionHelpFormatter)


def run_parsed(parser: argparse.ArgumentParser) -> int:
    """Call the function `call` that the parser sets on the arguments of the command line.

    Returns:
        the exit code that it returns, or 0 where it returns None.
    """
    arguments = parser.parse_args()
    try:
        with shown(quiet=getattr(arguments, "quiet", False)):
            return arguments.call(arguments) or 0
    except UserError as error:
        fail(error)
