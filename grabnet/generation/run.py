"""Grasps for the meshes a user names: what `scripts/sample.py` does."""

from __future__ import annotations

import math
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from hydra.utils import instantiate

from grabnet.body.hand import HandModel
from grabnet.data.objects import MESH_SUFFIXES
from grabnet.errors import UserError
from grabnet.generation.export import FORMATS, result_folders, write_grasps
from grabnet.generation.grabber import ORIENTATIONS, SIDES, Grabber
from grabnet.generation.grasps import DEFINITIONS
from grabnet.geometry.mesh import check_size, file_to_object, load_mesh
from grabnet.io.files import existing, sha256
from grabnet.io.provenance import provenance
from grabnet.models.trained import check_hand, find_pair
from grabnet.models.weights import load_coarsenet, load_refinenet
from grabnet.visual.pictures import can_render


@dataclass(frozen=True)
class Sampling:
    """What to sample; the values of `configs/sample.yaml`, which explains them.

    Raises:
        UserError: a value that is wrong whatever the mesh.
    """

    mesh: str | list[str]
    output: str
    n: int
    seed: int
    hand: str
    refine: bool
    format: str | list[str] | None
    scale: float
    max_size: float
    min_size: float
    up: str | None
    orientation: str
    betas: list[float] | None
    coarsenet: str | None
    refinenet: str | None
    runs: str
    hand_model: dict[str, Any]
    cache_dir: str | None
    batch_size: int
    n_turns: int
    sheet: int
    page: int

    def __post_init__(self):
        for name, least in {"n": 1, "seed": 0, "batch_size": 1, "n_turns": 1, "sheet": 0, "page": 0}.items():
            if getattr(self, name) < least:
                raise UserError(f"{name} is {getattr(self, name)}; it must be at least {least}.")
        if not (math.isfinite(self.scale) and self.scale > 0):
            raise UserError(f"scale is {self.scale}; it must be a positive number of metres per unit of the mesh.")
        if wrong := [b for b in self.betas or [] if not isinstance(b, float | int)]:
            raise UserError(f"betas holds {wrong[0]!r}; it must be a list of numbers.")
        options = {"hand": SIDES, "orientation": ORIENTATIONS, "up": (None, "x", "y", "z")}
        for name, values in options.items():
            if getattr(self, name) not in values:
                raise UserError(f"{name} is '{getattr(self, name)}'; it can be {', '.join(filter(None, values))}.")
        if unknown := [f for f in self.formats if f not in FORMATS]:
            raise UserError(f"format is '{unknown[0]}'; it can be any of {', '.join(FORMATS)}.")

    @property
    def formats(self) -> list[str]:
        return _listed(self.format)


def sample(wanted: Sampling) -> int:
    """Write the grasps of every mesh into a folder of its own below the output folder.

    A mesh that cannot be used is told of in one sentence on stderr, and the others go on.

    Returns:
        how many meshes failed.

    Raises:
        UserError: nothing can be sampled at all, such as for want of a network.
    """
    files, failures = _mesh_files(_listed(wanted.mesh))
    grabber, networks = _grabber(wanted)
    sheet = wanted.sheet
    if sheet and (reason := can_render()):
        print(reason)
        sheet = 0
    record = {
        **networks,
        "hand_sha256": sha256(grabber.hand.v_template.numpy()),
        "config": asdict(wanted),
        "definitions": DEFINITIONS,
        "provenance": provenance(),
    }
    for file, folder in result_folders(files, Path(wanted.output).expanduser()).items():
        try:
            mesh = load_mesh(file)
            to_object = file_to_object(file, wanted.scale, wanted.up)
            check_size(mesh.transformed(to_object), file, wanted.max_size, wanted.min_size)
            grasps = grabber(
                mesh,
                wanted.n,
                wanted.seed,
                wanted.hand,
                wanted.orientation,
                None if wanted.betas is None else torch.tensor(wanted.betas, dtype=torch.float32),
                to_object,
                wanted.cache_dir,
            )
            about = {"name": file.name, "mesh": str(file.resolve()), "mesh_sha256": sha256(file)}
            write_grasps(folder, grasps, about | record, wanted.formats, sheet, wanted.page)
            print(f"{file}: {grasps.summary()}; pictures, page and files are in {folder}")
        except UserError as error:
            failures.append(str(error))
        except OSError as error:
            failures.append(f"{error.filename or folder} cannot be written ({error.strerror}).")
    for sentence in failures:
        print(f"error: {sentence}", file=sys.stderr)
    return len(failures)


def _grabber(wanted: Sampling) -> tuple[Grabber, dict[str, Any]]:
    """The networks with their hand, and which they are."""
    hand: HandModel = instantiate(wanted.hand_model)
    if wanted.betas and len(wanted.betas) > hand.shapedirs.shape[-1]:
        raise UserError(f"betas has {len(wanted.betas)} values; this hand model has {hand.shapedirs.shape[-1]}.")
    paths = dict(
        zip(("coarsenet", "refinenet"), find_pair(wanted.coarsenet, wanted.refinenet, wanted.runs), strict=True)
    )
    if not wanted.refine:
        del paths["refinenet"]
    facts = {}
    for name, path in paths.items():
        check_hand(path, hand)
        print(f"{name}: {path}")
        facts |= {name: str(path.resolve()), f"{name}_sha256": sha256(path)}
    refinenet = load_refinenet(paths["refinenet"], hand) if wanted.refine else None
    return Grabber(load_coarsenet(paths["coarsenet"]), refinenet, hand, wanted.batch_size, wanted.n_turns), facts


def _mesh_files(named: list[str]) -> tuple[list[Path], list[str]]:
    """The mesh files named, those in the folders named, each once; and a sentence for each name that gives none."""
    files: dict[Path, Path] = {}
    failures = []
    for name in named:
        try:
            path = existing(Path(name).expanduser(), "Mesh")
            inside = [path]
            if path.is_dir():
                inside = sorted(p for p in path.iterdir() if p.suffix.lower() in MESH_SUFFIXES and p.is_file())
                if not inside:
                    raise UserError(f"The folder {path} holds no mesh ({', '.join(MESH_SUFFIXES)}).")
            files |= {p.resolve(): p for p in inside}
        except UserError as error:
            failures.append(str(error))
    return list(files.values()), failures


def _listed(value: str | list[str] | None) -> list[str]:
    return [value] if isinstance(value, str) else list(value or [])
