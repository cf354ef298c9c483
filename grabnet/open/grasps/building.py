"""The command that makes the shipped grasps: all objects, with progress, a table of results and the files."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from grabnet.body.hand import OPEN_HANDS
from grabnet.cli.ends import note
from grabnet.cli.progress import track
from grabnet.errors import UserError
from grabnet.geometry.rotations import matrix_to_axis_angle
from grabnet.grasping.proposing.proposals import KIND_NAMES
from grabnet.io.files import sha256, write_json
from grabnet.io.provenance import provenance
from grabnet.open.grasps.store import OpenGrasps, save_open_grasps
from grabnet.open.grasps.synthesise import (
    GENDERS,
    SUBJECTS,
    ObjectGrasps,
    SynthesisConfig,
    subject_betas,
    synthesise,
)
from grabnet.open.objects import OBJECTS

_COLUMNS = {
    "grasps": "grasps",
    "accepted": "accepted",
    "stable": "stable",
    "clear_of_table": "clear of table",
    "max_penetration_mm": "max pen. mm",
    "mean_penetration_mm": "mean pen. mm",
    "contact_vertices": "contacts",
    "fingers_in_contact": "fingers",
    "kinds": "pinch/tripod/precision/power/lateral",
}


def build_grasps(
    path: str | Path, objects: Sequence[str] | None, per_object: int, seed: int, processes: int
) -> OpenGrasps:
    """Synthesise grasps and write them to `path`, with provenance and a report beside.

    Args:
        objects: names; all when omitted.

    Raises:
        UserError: unknown object, or no MuJoCo.
    """
    names = list(objects or OBJECTS)
    if unknown := sorted(set(names) - set(OBJECTS)):
        raise UserError(f"There is no open object {', '.join(unknown)}; choose from {', '.join(OBJECTS)}.")
    if importlib.util.find_spec("mujoco") is None:
        raise UserError('Grasps are checked in MuJoCo, which is not installed: pip install "grabnet[evaluation]".')
    config = SynthesisConfig(per_object=per_object)
    found: list[ObjectGrasps] = []
    for done in track(synthesise(names, config, seed, processes), "Synthesising grasps of objects", len(names)):
        found.append(done)
        row = done.report
        print(f"{done.name}: {row['grasps']} grasps, {row['accepted']:.0%} accepted, {row['stable']:.0%} stable")
    grasps = write_asset(Path(path), found, subject_betas(config, seed), config, seed)
    Console().print(_table(found))
    note(f"Wrote {len(grasps)} grasps of {len(found)} objects to {path}.")
    return grasps


def collect(found: Sequence[ObjectGrasps], betas: Tensor, config: SynthesisConfig, seed: int) -> OpenGrasps:
    """One `OpenGrasps` of the `ObjectGrasps` of all objects, sorted by object name."""
    found = sorted(found, key=lambda o: o.name)
    number = torch.cat([torch.full((len(o.kind),), i) for i, o in enumerate(found)])
    return OpenGrasps(
        tuple(o.name for o in found),
        SUBJECTS,
        GENDERS,
        KIND_NAMES,
        number,
        torch.cat([o.subject for o in found]),
        torch.cat([o.kind for o in found]),
        torch.cat([o.clears_table for o in found]),
        torch.cat([o.pose.angles for o in found]),
        matrix_to_axis_angle(torch.cat([o.pose.rotation for o in found])),
        torch.cat([o.transl for o in found]),
        betas,
        {
            "seed": seed,
            "hand_sha256": sha256(OPEN_HANDS / "MANO_RIGHT.npz"),
            "object_sha256": {o.name: o.mesh_sha256 for o in found},
            "config": asdict(config),
        },
    )


def write_asset(
    path: Path, found: Sequence[ObjectGrasps], betas: Tensor, config: SynthesisConfig, seed: int
) -> OpenGrasps:
    """Write the grasp file and beside it `grasps.json` (provenance) and `report.json` (a row per object)."""
    grasps = collect(found, betas, config, seed)
    save_open_grasps(path, grasps)
    write_json(
        path.with_suffix(".json"),
        provenance(
            file=path.name,
            sha256=sha256(path),
            grasps=len(grasps),
            source="synthesised by scripts/build_open.py grasps from the open hand and open objects; nothing recorded",
            licence="CC0-1.0",
            **grasps.meta,
        ),
    )
    write_json(path.with_name("report.json"), {o.name: o.report for o in sorted(found, key=lambda o: o.name)})
    return grasps


def _table(found: Sequence[ObjectGrasps]) -> Table:
    table = Table("object", *_COLUMNS.values())
    for result in sorted(found, key=lambda o: o.name):
        cells = (result.report[column] for column in _COLUMNS)
        table.add_row(result.name, *("/".join(map(str, c.values())) if isinstance(c, dict) else str(c) for c in cells))
    return table
