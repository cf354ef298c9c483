"""Turn a published checkpoint into this project's format.

    python scripts/import_checkpoint.py coarsenet coarsenet.pt --bps bps.npz
    python scripts/import_checkpoint.py refinenet refinenet.pt --hand-model MANO_RIGHT.npz

What comes out is found by scripts/sample.py like a network trained here.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from grabnet.body.hand import HandModel
from grabnet.cli.entry import fail
from grabnet.errors import UserError
from grabnet.io.files import sha256
from grabnet.io.provenance import provenance
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.refinenet import RefineNet
from grabnet.models.weights import FILE_NAME, save_network


def coarsenet(arguments: argparse.Namespace) -> None:
    network = CoarseNet.from_published(arguments.checkpoint, arguments.bps)
    save_network(arguments.output, network, _record(arguments, bps_sha256=sha256(arguments.bps)))


def refinenet(arguments: argparse.Namespace) -> None:
    hand = HandModel(arguments.hand_model)
    network = RefineNet.from_published(arguments.checkpoint, hand)
    save_network(arguments.output, network, _record(arguments, hand_sha256=sha256(hand.v_template.numpy())))


def _record(arguments: argparse.Namespace, **facts: str) -> dict[str, object]:
    return provenance(source="published checkpoint", checkpoint_sha256=sha256(arguments.checkpoint), **facts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True, metavar="coarsenet | refinenet")
    for run, option, about in (
        (coarsenet, "--bps", "the published bps.npz, whose points the weights hold for"),
        (refinenet, "--hand-model", "MANO_RIGHT.npz or .pkl, which the weights hold for"),
    ):
        command = commands.add_parser(run.__name__)
        command.add_argument("checkpoint", type=Path, help=f"{run.__name__}.pt")
        command.add_argument(option, type=Path, required=True, help=about)
        output = Path("runs/published") / run.__name__ / FILE_NAME
        command.add_argument("--output", type=Path, default=output, help="(default: %(default)s)")
        command.set_defaults(run=run)
    arguments = parser.parse_args()
    try:
        arguments.run(arguments)
    except UserError as error:
        fail(error)
    print(f"Wrote {arguments.output}")


if __name__ == "__main__":
    main()
