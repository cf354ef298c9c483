"""Grasps on disk: parameters, meshes, measurements, pictures and the page to turn them."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from grabnet.contact.hands import ContactMaps
from grabnet.generation.contact_maps import write_contact_maps
from grabnet.generation.gallery import grasp_sheet
from grabnet.generation.grasps import RESULTS, Grasps, has_results, record_of
from grabnet.generation.viewer import write_viewer
from grabnet.io.files import filling
from grabnet.io.names import LONGEST_NAME
from grabnet.visual.pictures import save_image


def result_folders(meshes: Sequence[Path], output: Path) -> dict[Path, Path]:
    """A folder below `output` for each mesh, called like the mesh.

    One that holds something other than earlier results of this very mesh is passed over for `<name>-2` and so on:
    meshes of the same name from different places never overwrite each other.
    """
    folders: dict[Path, Path] = {}
    taken: set[str] = set()
    for mesh in meshes:
        plain = _plain(mesh)
        names = itertools.chain([plain], (f"{plain}-{k}" for k in itertools.count(2)))
        # Some file systems take Cup and cup for the same.
        name = next(n for n in names if n.casefold() not in taken and _free_for(mesh, output / n))
        taken.add(name.casefold())
        folders[mesh] = output / name
    return folders


def _plain(mesh: Path) -> str:
    """The mesh's name without its ending, cut so that temporary and numbered names beside it fit on a disk; one of dots
    alone would name `output` itself or the folder above it."""
    stem = os.fsencode(mesh.stem)
    plain = mesh.stem if len(stem) <= LONGEST_NAME else stem[:LONGEST_NAME].decode(errors="ignore")
    return plain if plain.strip(". ") else "mesh"


def _free_for(mesh: Path, folder: Path) -> bool:
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return True
    return record_of(folder).get("mesh") == os.path.realpath(mesh)


def write_grasps(
    folder: str | Path,
    grasps: Grasps,
    record: dict[str, Any],
    formats: Sequence[str] = ("glb",),
    sheet: int = 40,
    page: int = 500,
    contact: ContactMaps | None = None,
) -> None:
    """Write everything about one object's grasps into `folder`; nothing of it is to be seen before all is written.

    Args:
        folder: gets what `Grasps.save` writes, index.html and contact_sheet.png.
        grasps: of the object.
        record: facts for grasps.json; `name` is the title of the page.
        formats: of the meshes.
        sheet: grasps in contact_sheet.png, at most; no picture for 0.
        page: grasps in index.html, at most; no page for 0.
        contact: of the grasps, for contact.npz and, where `formats` has ply, coloured meshes; not written when omitted.
    """
    with filling(folder, RESULTS, has_results) as temporary:
        if page:
            write_viewer(temporary / "index.html", grasps.first(page), record["name"])
        if sheet:
            save_image(temporary / "contact_sheet.png", grasp_sheet(grasps.first(sheet)))
        if contact is not None:
            write_contact_maps(temporary, contact, grasps, "ply" in formats)
        grasps.write(temporary, formats, record)
