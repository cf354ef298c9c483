"""Make a small copy of a trained network to pass on: matrices in half precision, with config and metrics beside.

grabnet ship runs/open/coarsenet assets/open_grabber/coarsenet
"""

from __future__ import annotations

import json
from pathlib import Path

from omegaconf import OmegaConf

from grabnet.cli.ends import note
from grabnet.cli.parsed import make_parser, run_parsed
from grabnet.errors import UserError
from grabnet.io.files import replacing, sha256, write_json


def main() -> int:
    parser = make_parser(__doc__, folders=["folder"])
    parser.add_argument("run", type=Path, metavar="RUN", help="run folder")
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="where the copy goes")
    parser.set_defaults(call=lambda arguments: ship(arguments.run, arguments.folder))
    return run_parsed(parser)


def ship(run: Path, folder: Path) -> None:
    """Write model.safetensors, config.yaml and metrics.json of a run into `folder`."""
    import torch

    from grabnet.body.hand import HandModel
    from grabnet.models.trained import is_trial
    from grabnet.models.weights import FILE_NAME, load_network, read_provenance, save_network, weights_file

    file = weights_file(run)
    if is_trial(file):
        raise UserError(f"{file} was only tried out (trial=true, as debug=… sets it): train it for real before.")
    network = load_network(file, HandModel.open())
    record = read_provenance(file)
    if missing := [name for name in ("config", "metrics") if not isinstance(record.get(name), dict)]:
        raise UserError(f"{file} has no {' and no '.join(missing)} in its record: ship a run of train.py.")
    # Paths become relative to the current folder: those of this machine mean nothing elsewhere.
    record = json.loads(json.dumps(record).replace(f"{Path.cwd()}/", ""))
    save_network(folder / FILE_NAME, network, record | {"rounded_from_sha256": sha256(file)}, torch.float16)
    with replacing(folder / "config.yaml") as temporary:
        OmegaConf.save(OmegaConf.create(record["config"]), temporary)
    write_json(folder / "metrics.json", record["metrics"])
    note(f"{folder}: {(folder / FILE_NAME).stat().st_size / 1e6:.1f} MB")
