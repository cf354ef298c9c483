"""Commands that take their arguments from argparse."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection
from typing import Any, NoReturn

from grabnet.cli.checks import mismatch
from grabnet.cli.ends import fail, in_sentences
from grabnet.cli.help import EXIT_CODES
from grabnet.cli.places import refuse_unwritable
from grabnet.cli.progress import shown
from grabnet.errors import UserError


def number(hint: Any) -> Callable[[str], int]:
    """What argparse makes an int of an argument by, which is held to an annotation such as `Count`."""

    def parse(text: str) -> int:
        value = int(text)
        if found := mismatch(value, hint):
            raise argparse.ArgumentTypeError(f"{value} is out of range; it {found[1]}")
        return value

    parse.__name__ = "whole number"  # which argparse names where the text is none
    return parse


class Parser(argparse.ArgumentParser):
    """A parser, as each of its subparsers, with --quiet, and with a sentence for each error.

    Args:
        folders, files: arguments that the command writes to.
    """

    def __init__(self, *arguments: Any, folders: Collection[str] = (), files: Collection[str] = (), **options: Any):
        super().__init__(*arguments, formatter_class=argparse.RawDescriptionHelpFormatter, **options)
        self.set_defaults(written=dict.fromkeys(folders, True) | dict.fromkeys(files, False))
        self.add_argument("--quiet", action="store_true", default=argparse.SUPPRESS, help="show no progress")

    def error(self, message: str) -> NoReturn:
        fail(UserError(f"{message}; {self.prog} --help explains its arguments."))


def make_parser(about: str | None, **options: Any) -> Parser:
    """A parser whose help says what the command does and what its exit codes mean."""
    return Parser(description=about, epilog=EXIT_CODES, **options)


def run_parsed(parser: argparse.ArgumentParser) -> int:
    """Call the function `call` that the parser sets on the arguments of the command line.

    Returns:
        the exit code that it returns, or 0 where it returns None.
    """
    with in_sentences():
        arguments = parser.parse_args()
        for name, is_folder in arguments.written.items():
            if (path := getattr(arguments, name)) is not None:
                refuse_unwritable(path, name, is_folder)
        with shown(quiet=getattr(arguments, "quiet", False)):
            return arguments.call(arguments) or 0
