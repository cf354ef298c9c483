"""Unpack the zip files of GRAB or GrabNet: `python scripts/unpack_grab.py <folder of zips> <folder to unpack into>`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from grabnet.cli.entry import fail
from grabnet.data.unpacking import unpack
from grabnet.errors import UserError


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("downloads", type=Path, help="folder with the zip files as downloaded, or one zip file")
    parser.add_argument(
        "root", type=Path, help="where grab/, tools/ or data/ go; started again, it goes on where it stopped"
    )
    arguments = parser.parse_args()
    try:
        failures = unpack(arguments.downloads, arguments.root)
    except UserError as error:
        fail(error)
    for sentence in failures:
        print(f"error: {sentence}", file=sys.stderr)
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
