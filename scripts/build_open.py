"""Build the open stand-ins for licensed data: hand, objects, grasps.

    python scripts/build_open.py objects            # object meshes, in the layout of GRAB
    python scripts/build_open.py --help

One subparser below per thing to build; what it does lives in grabnet/open/.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from grabnet.errors import UserError


def objects(arguments: argparse.Namespace) -> None:
    from grabnet.open.objects.writing import write_objects

    write_objects(arguments.root, processes=arguments.processes)


def parser() -> argparse.ArgumentParser:
    main = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = main.add_subparsers(dest="command", required=True, metavar="hand | objects | grasps")

    command = commands.add_parser("objects", help="mesh the open objects, one .ply each; those up to date are kept")
    command.add_argument("--root", type=Path, default=Path("data/open"), help="dataset folder (default: %(default)s)")
    command.add_argument("--processes", type=int, default=2, help="objects meshed at once (default: %(default)s)")
    command.set_defaults(run=objects)

    return main


if __name__ == "__main__":
    arguments = parser().parse_args()
    try:
        arguments.run(arguments)
    except UserError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
