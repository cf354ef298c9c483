"""The published GrabNet data in its true layout (ref. 2), made of the open hand and objects of our own."""

from __future__ import annotations

import pickle
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
import trimesh
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from grabnet.body.hand import OPEN_HANDS, HandModel
from grabnet.geometry.mesh import Mesh, load_mesh, save_mesh
from grabnet.io.npz import read_npz

Frames = Mapping[str, Sequence[tuple[str, str, int]]]
# (subject, recording, frame) of each split, not in order.
FRAMES: Frames = {
    "train": [("s1", "ball_pass_1", 30), ("s2", "can_offhand_use_2", 7), ("s1", "ball_pass_1", 10)],
    "val": [("s1", "ring_lift_1", 1), ("s2", "ring_use_1", 2)],
    "test": [("s2", "block_use_1", 4)],
}
GEOMETRY = ("verts_rhand", "verts_rhand_f", "verts_object", "bps_object")


class Shown(NamedTuple):
    """One frame in the release's world: hand and noisy hand (778, 3), vertices of the object's mesh (W, 3), metres."""

    vertices: np.ndarray
    noisy: np.ndarray
    object: np.ndarray


def write_objects(folder: Path) -> Path:
    """Closed objects whose mean vertex lies centimetres off the middle of the box, both off the mesh's origin."""
    bodies = {
        "ball": trimesh.creation.icosphere(2, 0.035),
        "block": trimesh.creation.box((0.05, 0.06, 0.08)),
        "can": trimesh.creation.cylinder(0.03, 0.12),
        "ring": trimesh.creation.torus(0.04, 0.012),
    }
    knob = trimesh.creation.icosphere(4, 0.01)
    for name, body in bodies.items():
        knob_here = knob.copy().apply_translation(body.bounds[1] * (0.6, 0.9, 0.7))
        mesh = trimesh.util.concatenate([body, knob_here]).apply_translation((0.1, -0.05, 0.02))
        folder.mkdir(parents=True, exist_ok=True)
        save_mesh(folder / f"{name}.ply", Mesh(mesh.vertices, mesh.faces))
    return folder


def hand_file(folder: Path) -> Path:
    """The open hand under the name and in the format of the licensed one."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "MANO_RIGHT.pkl").write_bytes(pickle.dumps(read_npz(OPEN_HANDS / "MANO_RIGHT.npz")))
    return folder / "MANO_RIGHT.pkl"


def write_release(
    folder: Path, meshes: Path, layout: str = "frames", by_rows: bool = True, frames: Frames = FRAMES
) -> dict[tuple[str, int], Shown]:
    """Random grasps as published, the hand touching the object's surface.

    Args:
        folder: where `data` is made.
        meshes: folder of the objects' meshes.
        layout: vertices and BPS in a file for each frame ("frames"), in `grabnet_<split>.npz` as well ("one file"), or
            left out ("parameters").
        by_rows: rotations of objects are for row vectors, GRAB's way.
        frames: subject, recording and frame of each row, by split.

    Returns:
        what each frame shows, by sequence and frame number.
    """
    hand, rng, data, shown = HandModel.open(), np.random.default_rng(0), folder / "data", {}
    betas = torch.randn(2, 10, generator=torch.Generator().manual_seed(1))
    subjects = {f"s{k + 1}": hand.shaped(betas[k]) for k in range(2)}
    info = {name: {"rh_vtemp": v.numpy(), "rh_betas": np.zeros(10), "gender": "male"} for name, v in subjects.items()}
    objects = {path.stem: load_mesh(path) for path in sorted(meshes.iterdir())}
    basis = rng.normal(0, 0.06, (4096, 3)).astype(np.float32)
    data.mkdir(parents=True)
    np.save(data / "sbj_info.npy", np.array(info, dtype=object))
    np.save(data / "obj_info.npy", np.array({name: {"mesh_file": f"{name}.ply"} for name in objects}, dtype=object))
    np.savez(data / "bps.npz", basis=basis[None])
    for split, rows in frames.items():
        columns: dict[str, list[Any]] = {}
        for subject, take, frame in rows:
            mesh = objects[take.split("_")[0]]
            values, shown[f"{subject}/{take}", frame] = _grasp(hand, subjects[subject], mesh, basis, by_rows, rng)
            for name, value in values.items():
                columns.setdefault(name, []).append(np.ascontiguousarray(value, "f4"))
            if layout == "frames":
                file = data / split / "data" / subject / take / f"{frame:05d}.npz"
                file.parent.mkdir(parents=True, exist_ok=True)
                np.savez(file, **{name: columns[name][-1] for name in GEOMETRY})
        (data / split).mkdir(exist_ok=True)
        kept = [name for name in columns if layout == "one file" or name not in GEOMETRY]
        np.savez_compressed(data / split / f"grabnet_{split}.npz", **{name: np.stack(columns[name]) for name in kept})
        paths = [f"/somewhere/data/{split}/data/{subject}/{take}/{frame:05d}.npz" for subject, take, frame in rows]
        np.savez(data / split / "frame_names.npz", frame_names=np.array(paths))
    return shown


def _grasp(
    hand: HandModel, rest: torch.Tensor, mesh: Mesh, basis: np.ndarray, by_rows: bool, rng: np.random.Generator
) -> tuple[dict[str, np.ndarray], Shown]:
    """All that is stored of a frame, by name, and what it shows."""
    wrist, turn = Rotation.random(2, rng).as_matrix()
    fingers = Rotation.from_rotvec(rng.normal(0, 0.3, (15, 3))).as_matrix()
    joints = np.concatenate([wrist[None], fingers])
    noisy_joints = joints @ Rotation.from_rotvec(rng.normal(0, 0.1, (16, 3))).as_matrix()
    middle = (mesh.vertices.astype(float).max(0) + mesh.vertices.min(0)) / 2
    points, normals = mesh.sample_surface(2048, int(rng.integers(1000)))
    world, points, normal = (mesh.vertices - middle) @ turn, (points - middle) @ turn, normals[0] @ turn

    def posed(joints: np.ndarray, transl: np.ndarray) -> np.ndarray:
        rotations, place = torch.tensor(joints[None]).float(), torch.tensor(transl[None]).float()
        return hand.pose(rotations, place, rest)[0][0].numpy()

    there = posed(joints, np.zeros(3))
    transl = points[0] - there[(there @ normal).argmin()]  # its foremost vertex on the surface, all others before it
    noisy_transl = transl + rng.normal(0, 0.01, 3)
    show = Shown(posed(joints, transl), posed(noisy_joints, noisy_transl), world)
    values = {
        "global_orient_rhand_rotmat": joints[:1],
        "fpose_rhand_rotmat": joints[1:],
        "trans_rhand": transl,
        "global_orient_rhand_rotmat_f": noisy_joints[:1],
        "fpose_rhand_rotmat_f": noisy_joints[1:],
        "trans_rhand_f": noisy_transl,
        "root_orient_obj_rotmat": turn if by_rows else turn.T,
        "trans_obj": np.zeros(3),
        "verts_rhand": show.vertices,
        "verts_rhand_f": show.noisy,
        "verts_object": points,
        "bps_object": KDTree(points).query(basis)[0],
    }
    return values, show


def zip_release(folder: Path, meshes: Path, downloads: Path) -> Path:
    """Pack a release and GRAB's meshes as they are downloaded: a zip file of each folder, named by its place.

    `data.zip` holds the files that lie in `data` itself, `data__<split>.zip` all that lies below a split.
    """
    data = folder / "data"
    packed = {"data": [data, *data.glob("*.np?")], "tools__object_meshes__contact_meshes": [meshes, *meshes.iterdir()]}
    packed |= {f"data__{split}": [data / split, *(data / split).rglob("*.npz")] for split in ("train", "val", "test")}
    downloads.mkdir(parents=True, exist_ok=True)
    for name, (top, *files) in packed.items():
        with zipfile.ZipFile(downloads / f"{name}.zip", "w") as archive:
            for file in files:
                archive.write(file, str(file.relative_to(top)))
    return downloads
