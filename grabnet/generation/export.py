"""Grasps on disk: parameters, meshes, measurements, pictures and the page to turn them."""

from __future__ import annotations

import itertools
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from grabnet.generation.gallery import grasp_sheet
from grabnet.generation.grasps import Grasps
from grabnet.generation.viewer import write_viewer
from grabnet.geometry.mesh import Mesh, save_mesh
from grabnet.geometry.rotations import matrix_to_axis_angle
from grabnet.io.files import write_json
from grabnet.visual.pictures import OBJECT, SKIN, save_image


def result_folders(meshes: Sequence[Path], output: Path) -> dict[Path, Path]:
    """A folder below `output` for each mesh, called like the mesh.

    One that holds something other than earlier results of this very mesh is passed over for `<name>-2` and so on:
    meshes of the same name from different places never overwrite each other.
    """
    folders: dict[Path, Path] = {}
    taken: set[str] = set()
    for mesh in meshes:
        names = itertools.chain([mesh.stem], (f"{mesh.stem}-{k}" for k in itertools.count(2)))
        # Some file systems take Cup and cup for the same.
        name = next(n for n in names if n.casefold() not in taken and _free_for(mesh, output / n))
        taken.add(name.casefold())
        folders[mesh] = output / name
    return folders


def _free_for(mesh: Path, folder: Path) -> bool:
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return True
    try:
        return json.loads((folder / "grasps.json").read_text(encoding="utf-8"))["mesh"] == str(mesh.resolve())
    except (OSError, ValueError, KeyError, TypeError):
        return False


def write_parameters(path: str | Path, grasps: Grasps) -> None:
    """Write `grasps.npz`, as the field's hand models take it (metres, radians, along the axes of the mesh's frame).

    global_orient (N, 3) and hand_pose (N, 45) axis-angle (flat_hand_mean), transl (N, 3), betas (N, n), side,
    units_per_metre () by which posed vertices are multiplied to lie in the mesh's units, object_transform (N, 4, 4)
    from the mesh's frame to the world each grasp was made in, seed ().
    """
    pose = grasps.parameters
    arrays = {
        "global_orient": matrix_to_axis_angle(pose.global_orient),
        "hand_pose": matrix_to_axis_angle(pose.hand_pose).flatten(1),
        "transl": pose.transl,
        "betas": grasps.betas,
        "object_transform": grasps.object_transform,
    }
    np.savez(
        path,
        **{name: value.numpy() for name, value in arrays.items()},
        side=np.array(grasps.side),
        units_per_metre=np.float64(grasps.units_per_metre),
        seed=np.int64(grasps.seed),
    )


def write_glb(folder: Path, grasps: Grasps) -> None:
    """`grasp_000.glb` …: scenes of the nodes "object" and "hand"."""
    solid = _coloured(grasps.mesh.vertices, grasps.mesh.faces, OBJECT)
    for i, vertices in enumerate(grasps.vertices.numpy()):
        hand = _coloured(vertices, grasps.faces.numpy(), SKIN)
        _ = hand.vertex_normals  # once computed they are written: the hand is smooth, the object may have edges
        scene = trimesh.Scene()
        for name, part in (("object", solid), ("hand", hand)):
            scene.add_geometry(part, node_name=name, geom_name=name)
        (folder / f"grasp_{i:03d}.glb").write_bytes(scene.export(file_type="glb"))


def write_ply(folder: Path, grasps: Grasps) -> None:
    """`object.ply` once and `hand_000.ply` …"""
    save_mesh(folder / "object.ply", grasps.mesh)
    for i, vertices in enumerate(grasps.vertices.numpy()):
        save_mesh(folder / f"hand_{i:03d}.ply", Mesh(vertices, grasps.faces.numpy()))


def write_npz(folder: Path, grasps: Grasps) -> None:
    """`meshes.npz`: hand_vertices (N, V, 3), hand_faces, object_vertices, object_faces."""
    np.savez(
        folder / "meshes.npz",
        hand_vertices=grasps.vertices.numpy(),
        hand_faces=grasps.faces.numpy(),
        object_vertices=grasps.mesh.vertices,
        object_faces=grasps.mesh.faces,
    )


FORMATS: dict[str, Callable[[Path, Grasps], None]] = {"glb": write_glb, "ply": write_ply, "npz": write_npz}


def write_grasps(
    folder: str | Path,
    grasps: Grasps,
    record: dict[str, Any],
    formats: Sequence[str] = ("glb",),
    sheet: int = 40,
    page: int = 500,
) -> None:
    """Write everything about one object's grasps into `folder`; nothing of it is to be seen before all is written.

    grasps.npz, grasps.json (`record`, and the list `grasps`), meshes/ in each of `formats`, all in the mesh's own frame
    and units; index.html of the first `page` grasps and contact_sheet.png of the first `sheet` (none for 0).
    """
    with _filling(Path(folder)) as temporary:
        write_parameters(temporary / "grasps.npz", grasps)
        for name in formats:
            (temporary / "meshes").mkdir(exist_ok=True)
            FORMATS[name](temporary / "meshes", grasps)
        if page:
            write_viewer(temporary / "index.html", grasps.first(page), record["name"])
        if sheet:
            save_image(temporary / "contact_sheet.png", grasp_sheet(grasps.first(sheet)))
        write_json(temporary / "grasps.json", record | {"grasps": grasps.report()})


_RESULTS = ("grasps.json", "grasps.npz", "meshes", "index.html", "contact_sheet.png")


@contextmanager
def _filling(folder: Path) -> Iterator[Path]:
    """A temporary folder beside `folder`, moved into its place when the block ends well and removed when it does not.

    Where `folder` exists, only the results of an earlier call are replaced; the user's own files in it stay.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        yield temporary
        folder.mkdir(exist_ok=True)
        # grasps.json goes first and comes last: where it lies, the results beside it are complete and belong to it.
        for name in _RESULTS:
            _remove(folder / name)
        for name in reversed(_RESULTS):
            if (temporary / name).exists():
                (temporary / name).replace(folder / name)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _coloured(vertices: np.ndarray, faces: np.ndarray, color: Sequence[float]) -> trimesh.Trimesh:
    material = trimesh.visual.material.PBRMaterial(
        baseColorFactor=[*color, 1.0], metallicFactor=0.0, roughnessFactor=0.7, doubleSided=True
    )
    visual = trimesh.visual.TextureVisuals(material=material)
    return trimesh.Trimesh(vertices, faces, visual=visual, process=False)
