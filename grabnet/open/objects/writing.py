"""Write the open objects where GRAB keeps its own: tools/object_meshes/contact_meshes/<name>.ply."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from grabnet.cli.progress import steps
from grabnet.data.objects import OBJECT_MESHES
from grabnet.errors import UserError
from grabnet.geometry.mesh import save_mesh
from grabnet.io.files import sha256, write_json
from grabnet.io.provenance import provenance
from grabnet.io.state import read_json
from grabnet.open.objects import OBJECTS, build_object

# Raise it when any object would be meshed otherwise: all are then meshed again.
FORMAT = 1
PROVENANCE = Path("tools/object_meshes/open_objects.json")


def write_objects(root: str | Path, processes: int = 2) -> list[Path]:
    """Mesh every object of `OBJECTS` under the dataset folder `root`.

    Files of the present `FORMAT` are kept, so an interrupted call continues where it stopped.
    `open_objects.json` beside the meshes records versions, format, sizes, counts and hashes.

    Returns:
        the path of each mesh, in the order of `OBJECTS`.
    """
    root = Path(root)
    (root / OBJECT_MESHES).mkdir(parents=True, exist_ok=True)
    facts = provenance(format=FORMAT)
    written = _up_to_date(root)
    missing = [name for name in OBJECTS if name not in written]
    # Spawned, not forked: a fork of a process with running threads (BLAS, torch) may hang.
    with (
        steps("Meshing objects", len(OBJECTS), len(written)) as counted,
        ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool,
    ):
        for future in as_completed([pool.submit(_write, name, root) for name in missing]):
            name, written[name] = future.result()
            write_json(root / PROVENANCE, facts | {"objects": {name: written[name] for name in sorted(written)}})
            counted.advance(about=name)
    return [root / OBJECT_MESHES / f"{name}.ply" for name in OBJECTS]


def _write(name: str, root: Path) -> tuple[str, dict[str, Any]]:
    mesh = build_object(name)
    path = root / OBJECT_MESHES / f"{name}.ply"
    save_mesh(path, mesh)
    return name, {
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "extents_mm": [round(1000 * float(side), 1) for side in mesh.extents],
        "volume_cm3": round(1e6 * mesh.volume, 1),
        "mesh": mesh.sha256,
        "file": sha256(path),
    }


def _up_to_date(root: Path) -> dict[str, dict[str, Any]]:
    """Records of the meshes that are still as the present format writes them."""
    try:
        said = read_json(root / PROVENANCE, {"format": int, "objects": {str: {"file": str}}}, "mesh them again")
        objects = said["objects"] if said["format"] == FORMAT else {}
        files = {name: root / OBJECT_MESHES / f"{name}.ply" for name in objects if name in OBJECTS}
        return {name: objects[name] for name, file in files.items() if sha256(file) == objects[name]["file"]}
    except (OSError, UserError):
        return {}  # nothing there yet, or not ours: everything is meshed again
