"""Turn a published checkpoint into this project's format.

    grabnet import coarsenet coarsenet.pt --bps bps.npz
    grabnet import refinenet refinenet.pt --hand-model MANO_RIGHT.npz

What comes out can be sampled like a network trained here, and is shown objects as the published networks were: about
the middle of the bounding box, by unsigned distances to points.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from grabnet.cli.ends import note
from grabnet.cli.parsed import make_parser, run_parsed

OUTPUTS = Path("runs/published")


def main() -> int:
    from grabnet.models.weights import FILE_NAME

    parser = make_parser(__doc__)
    commands = parser.add_subparsers(required=True, metavar="coarsenet | refinenet")
    for call, option, about in (
        (coarsenet, "--bps", "the published bps.npz, whose points the weights hold for"),
        (refinenet, "--hand-model", "MANO_RIGHT.npz or .pkl, which the weights hold for"),
    ):
        command = commands.add_parser(call.__name__, files=["output"])
        command.add_argument("checkpoint", type=Path, help=f"{call.__name__}.pt")
        command.add_argument(option, type=Path, required=True, help=about)
        output = OUTPUTS / call.__name__ / FILE_NAME
        command.add_argument("--output", type=Path, default=output, help="(default: %(default)s)")
        command.set_defaults(call=call)
    return run_parsed(parser)


def coarsenet(arguments: argparse.Namespace) -> None:
    from grabnet.io.files import sha256
    from grabnet.models.coarsenet import CoarseNet

    _save(arguments, CoarseNet.from_published(arguments.checkpoint, arguments.bps), bps_sha256=sha256(arguments.bps))


def refinenet(arguments: argparse.Namespace) -> None:
    from grabnet.body.hand import HandModel
    from grabnet.models.refinenet import RefineNet

    _save(arguments, RefineNet.from_published(arguments.checkpoint, HandModel(arguments.hand_model)))


def _save(arguments: argparse.Namespace, network: Any, **facts: str) -> None:
    from grabnet.io.files import sha256
    from grabnet.io.provenance import provenance
    from grabnet.models.weights import save_network

    record = provenance(source="published checkpoint", checkpoint_sha256=sha256(arguments.checkpoint), **facts)
    save_network(arguments.output, network, record)
    note(f"Wrote {arguments.output}")
