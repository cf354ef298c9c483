"""Unpack the zip files of GRAB or of the GrabNet data.

grabnet unpack <folder of zips, or one zip> <folder to unpack into>
"""

from __future__ import annotations

import argparse
from pathlib import Path

from grabnet.cli.ends import say
from grabnet.cli.parsed import make_parser, run_parsed


def main() -> int:
    parser = make_parser(__doc__, folders=["root"])
    parser.add_argument("downloads", type=Path, help="folder with the zip files as downloaded, or one zip file")
    parser.add_argument("root", type=Path, help="where grab/, tools/ or data/ go; started again, it resumes")
    parser.set_defaults(call=_unpack)
    return run_parsed(parser)


def _unpack(arguments: argparse.Namespace) -> int:
    from grabnet.data.unpacking import unpack

    failures = unpack(arguments.downloads, arguments.root)
    for sentence in failures:
        say(sentence)
    return 1 if failures else 0
