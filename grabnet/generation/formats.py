"""Meshes of hands and object in files of several formats, in the frame and units of the object's mesh."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import trimesh

from grabnet.cli.progress import track
from grabnet.geometry.mesh import Mesh, save_mesh
from grabnet.geometry.object_mesh import ObjectMesh
from grabnet.visual.pictures import OBJECT, SKIN
from grabnet.visual.scenes import glb


def write_glb(folder: Path, placed: ObjectMesh, hands: np.ndarray, faces: np.ndarray) -> None:
    """`grasp_000.glb` …: scenes of the nodes "object" and "hand", below one that stands them up in metres."""
    solid = _coloured(placed.mesh.vertices, placed.mesh.faces, OBJECT)
    for i, vertices in enumerate(track(hands, "Writing meshes")):
        hand = _coloured(vertices, faces, SKIN)
        _ = hand.vertex_normals  # once computed they are written: the hand is smooth, the object may have edges
        (folder / f"grasp_{i:03d}.glb").write_bytes(glb({"object": solid, "hand": hand}, placed.to_object))


def write_ply(folder: Path, placed: ObjectMesh, hands: np.ndarray, faces: np.ndarray) -> None:
    """`object.ply` once and `hand_000.ply` …"""
    save_mesh(folder / "object.ply", placed.mesh)
    for i, vertices in enumerate(track(hands, "Writing meshes")):
        save_mesh(folder / f"hand_{i:03d}.ply", Mesh(vertices, faces))


def write_npz(folder: Path, placed: ObjectMesh, hands: np.ndarray, faces: np.ndarray) -> None:
    """`meshes.npz`: hand_vertices (N, V, 3), hand_faces, object_vertices, object_faces."""
    np.savez(
        folder / "meshes.npz",
        hand_vertices=hands,
        hand_faces=faces,
        object_vertices=placed.mesh.vertices,
        object_faces=placed.mesh.faces,
    )


# Of all files that these write, as patterns.
MESH_NAMES = ("grasp_[0-9][0-9][0-9]*.glb", "object.ply", "hand_[0-9][0-9][0-9]*.ply", "meshes.npz")

# Each writes the object, hands (N, V, 3) and their faces (F, 3) into a folder.
FORMATS: dict[str, Callable[[Path, ObjectMesh, np.ndarray, np.ndarray], None]] = {
    "glb": write_glb,
    "ply": write_ply,
    "npz": write_npz,
}


def _coloured(vertices: np.ndarray, faces: np.ndarray, color: Sequence[float]) -> trimesh.Trimesh:
    material = trimesh.visual.material.PBRMaterial(
        baseColorFactor=[*color, 1.0], metallicFactor=0.0, roughnessFactor=0.7, doubleSided=True
    )
    visual = trimesh.visual.TextureVisuals(material=material)
    return trimesh.Trimesh(vertices, faces, visual=visual, process=False)
