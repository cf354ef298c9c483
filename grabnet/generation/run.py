"""Grasps for the meshes a user names: what `scripts/sample.py` does."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path

from grabnet.body.hand import HandModel
from grabnet.cli.ends import as_user_error, note, say, unexpected
from grabnet.cli.progress import track
from grabnet.data.objects import MESH_SUFFIXES
from grabnet.errors import UserError
from grabnet.generation.config import SamplingConfig, listed, usable_device
from grabnet.generation.contact_maps import contact_maps
from grabnet.generation.export import result_folders, write_grasps
from grabnet.generation.grabber import Grabber
from grabnet.io.files import existing, sha256
from grabnet.io.names import is_hidden
from grabnet.io.provenance import provenance
from grabnet.visual.pictures import can_render


def run(config: SamplingConfig) -> int:
    """Write the grasps of every mesh into a folder of its own below the output folder.

    A mesh that cannot be used is reported in one sentence on stderr, and the others go on.

    Returns:
        exit code: 0, or 1 where a mesh failed.

    Raises:
        UserError: nothing can be sampled at all, such as for want of a network.
    """
    files, failures = _mesh_files(listed(config.mesh))
    hand = HandModel(config.hand_model) if config.hand_model else HandModel.open("right")
    grabber = Grabber.from_pretrained(
        config.model if isinstance(config.model, str) else list(config.model),
        hand,
        config.refine,
        config.runs,
        batch_size=config.batch_size,
        n_turns=config.n_turns,
        optimise=config.optimise,
        candidates=config.candidates,
        optimiser=config.optimiser,
        ranking=config.ranking,
    )
    most = hand.shapedirs.shape[-1]
    if len(config.betas or []) > most:
        raise UserError(f"betas has {len(config.betas)} values; this hand model has {most}.")
    sheet = config.sheet
    if sheet and (reason := can_render()):
        note(reason)
        sheet = 0
    record = {
        "networks": {
            kind: {"file": str(path.resolve()), "sha256": sha256(path)} for kind, path in grabber.weights.items()
        },
        "hand_sha256": hand.fingerprint,
        "config": asdict(config),
        "provenance": provenance(),
    }
    for kind, path in grabber.weights.items():
        note(f"{kind}: {path}")
    grabber.to(usable_device(config.device))
    for file, folder in track(result_folders(files, Path(config.output).expanduser()).items(), "Sampling meshes"):
        try:
            grasps = grabber(
                file,
                config.n,
                config.seed,
                config.hand,
                config.orientation,
                config.betas,
                scale=config.scale,
                up=config.up,
                max_size=config.max_size,
                min_size=config.min_size,
                contact_distance=config.contact_distance,
                table=config.table,
                cache_dir=config.cache_dir,
            )
            about = {"name": file.name, "mesh": str(file.resolve()), "mesh_sha256": sha256(file)}
            contact = contact_maps(grasps, hand, config.contact) if config.contact_maps else None
            write_grasps(folder, grasps, about | record, listed(config.format), sheet, config.page, contact)
            note(f"{file}: {grasps.summary()}; all is in {folder}")
        except Exception as error:  # nothing that one mesh meets ends the others
            failures.append(str(as_user_error(error) or f"{file}: {unexpected(error)}"))
    for sentence in failures:
        say(sentence)
    return 1 if failures else 0


def _mesh_files(named: list[str]) -> tuple[list[Path], list[str]]:
    """The mesh files named, those in the folders named, each once; and a sentence for each name that gives none."""
    files: dict[str, Path] = {}
    failures = []
    for name in named:
        try:
            path = existing(Path(name).expanduser(), "Mesh")
            inside = [path]
            if path.is_dir():
                # Whatever they are: what cannot be read is reported.
                meshes = (p for p in path.iterdir() if p.suffix.lower() in MESH_SUFFIXES)
                inside = sorted(p for p in meshes if not is_hidden(p.name))
                if not inside:
                    raise UserError(f"The folder {path} holds no mesh ({', '.join(MESH_SUFFIXES)}).")
            files |= {os.path.realpath(p): p for p in inside}  # of links to themselves, too
        except (UserError, OSError) as error:
            failures.append(str(as_user_error(error)))
    return list(files.values()), failures
