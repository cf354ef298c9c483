"""Make a small copy of a trained network to hand on: matrices in half precision, with config and metrics beside.

python scripts/ship_weights.py runs/open/coarsenet assets/open_grabber/coarsenet
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import torch
from omegaconf import OmegaConf

from grabnet.body.hand import HandModel
from grabnet.cli.entry import fail
from grabnet.errors import UserError
from grabnet.io.files import replacing, sha256, write_json
from grabnet.models.weights import (
    FILE_NAME,
    load_network,
    read_provenance,
    save_network,
    weights_file,
)


def ship(run: Path, folder: Path) -> None:
    """Write model.safetensors, config.yaml and metrics.json of a run into `folder`."""
    file = weights_file(run)
    network = load_network(file, HandModel.open())
    # Whoever gets it has no use for where this machine keeps things: paths become relative to here.
    record = json.loads(json.dumps(read_provenance(file)).replace(f"{Path.cwd()}/", ""))
    save_network(folder / FILE_NAME, network, record | {"rounded_from_sha256": sha256(file)}, torch.float16)
    with replacing(folder / "config.yaml") as temporary:
        OmegaConf.save(OmegaConf.create(record["config"]), temporary)
    write_json(folder / "metrics.json", record["metrics"])
    print(f"{folder}: {(folder / FILE_NAME).stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="run folder")
    parser.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    try:
        ship(arguments.run, arguments.folder)
    except UserError as error:
        fail(error)
