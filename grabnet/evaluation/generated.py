"""Grasps to evaluate: drawn from trained networks, or made elsewhere and read from a folder.

A folder holds one folder for each object, called like it, with either of

- `grasps.npz`, as `scripts/sample.py` writes it: global_orient (N, 3) and hand_pose (N, 45) axis-angle, radians,
  flat_hand_mean; transl (N, 3) metres; betas (N, n), and optionally side;
- hand meshes, `*.ply` or `*.obj` (also stl, off, glb), taken in the order of their names, all of one topology, each
  vertex number the same point of the hand.

Hands lie in the frame of the object's mesh in the data set, metres. Meshes with as many vertices as the hand model are
taken to have its vertices; of others, what needs to know the fingers is not measured.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from grabnet.body.hand import HandModel, HandParameters
from grabnet.data.objects import MESH_SUFFIXES
from grabnet.errors import UserError
from grabnet.evaluation.cache import Cache
from grabnet.evaluation.hands import Hands
from grabnet.generation.grabber import Grabber
from grabnet.geometry.mesh import Mesh, load_mesh
from grabnet.geometry.openings import boundary_loops
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.io.files import existing, sha256
from grabnet.io.npz import read_npz

GRASPS = "grasps.npz"
_PARAMETERS = {"global_orient": 3, "hand_pose": 45, "transl": 3}


def drawn(
    grabber: Grabber, sources: Sequence[str], mesh: Mesh, n: int, seed: int, grid_cache: str | None, cache: Cache
) -> Hands:
    """Grasps by a `Grabber`, as `scripts/sample.py` makes them, of the mean hand.

    Args:
        sources: what is drawn from: name of the variant and hashes of the networks' files.
        grid_cache: of signed-distance grids.
    """

    def draw() -> dict[str, np.ndarray]:
        grasps = grabber(mesh, n, seed, cache_dir=grid_cache)
        return {"vertices": grasps.vertices.numpy(), "hand_pose": grasps.parameters.hand_pose.numpy()}

    hand_hash = sha256(grabber.hand.v_template.cpu().numpy())
    sizes = f"{n} {seed} {grabber.settings} {grabber.finger.device.type}"
    arrays = cache.get("drawn", [*sources, mesh.sha256, hand_hash, sizes], draw)
    return Hands(faces=grabber.hand.faces.cpu().numpy(), **arrays)


def read_grasps(folder: Path, name: str, file: Path, hand: HandModel, n: int) -> Hands | None:
    """Return the first n grasps of an object in a folder of grasps made by any method; None where it has none for it.

    Args:
        folder: of folders called like objects.
        name: of the object.
        file: its mesh in the data set.
        hand: model that poses grasps given as parameters.
        n: grasps, at most.

    Raises:
        UserError: grasps that cannot be read, or that were made for another mesh of this name.
    """
    place = existing(folder, "Folder of grasps") / name
    if not place.is_dir():
        return None
    if (place / GRASPS).exists():
        _check_mesh(place, file)
        return _posed(place / GRASPS, hand, n)
    files = sorted(p for p in place.iterdir() if p.suffix.lower() in MESH_SUFFIXES and p.is_file())
    if not files:
        raise UserError(f"{place} holds neither {GRASPS} nor hand meshes ({', '.join(MESH_SUFFIXES)}).")
    meshes = [load_mesh(f, weld=False) for f in files[:n]]
    for path, mesh in zip(files, meshes, strict=False):
        if mesh.vertices.shape != meshes[0].vertices.shape or not np.array_equal(mesh.faces, meshes[0].faces):
            raise UserError(f"{path} has other vertices or faces than {files[0]}: all hands must share one topology.")
    try:
        boundary_loops(meshes[0].faces)
    except ValueError as error:
        raise UserError(f"{files[0]} cannot be closed at the wrist: {error}.") from None
    return Hands(vertices=np.stack([m.vertices for m in meshes]), faces=meshes[0].faces.astype(np.int64))


def _check_mesh(place: Path, file: Path) -> None:
    """Grasps that say which mesh they are of must be of the data set's."""
    record = place / "grasps.json"
    if not record.exists():
        return
    try:
        made_for = json.loads(record.read_text(encoding="utf-8")).get("mesh_sha256")
    except (OSError, ValueError, AttributeError) as error:
        raise UserError(f"{record} cannot be read ({error}); remove it, or make the grasps again.") from None
    if made_for not in (None, sha256(file)):
        raise UserError(f"The grasps in {place} were made for another mesh than {file}: make them for that one.")


def _posed(path: Path, hand: HandModel, n: int) -> Hands:
    values = read_npz(path)
    if missing := [name for name in _PARAMETERS if name not in values]:
        raise UserError(f"{path} has no {', '.join(missing)}; it needs {', '.join(_PARAMETERS)} and betas.")
    side = str(values.get("side", "right"))
    if side != ("right" if hand.is_right else "left"):
        raise UserError(f"{path} holds {side} hands, which this hand model does not pose: give them as meshes.")
    tensors = {}
    for name, width in _PARAMETERS.items():
        array = np.asarray(values[name])
        if array.shape != (len(values["transl"]), width) or array.dtype.kind != "f" or not np.isfinite(array).all():
            raise UserError(f"{path}: {name} has shape {array.shape}; (N, {width}) finite numbers are needed.")
        tensors[name] = torch.as_tensor(array[:n], dtype=torch.float32)
    if not len(tensors["transl"]):
        raise UserError(f"{path} holds no grasp.")
    pose = axis_angle_to_matrix(tensors["hand_pose"].unflatten(1, (15, 3)))
    parameters = HandParameters(axis_angle_to_matrix(tensors["global_orient"]), pose, tensors["transl"])
    try:
        betas = torch.as_tensor(np.asarray(values.get("betas", np.zeros((len(pose), 1))))[:n], dtype=torch.float32)
        vertices = hand(parameters, hand.shaped(betas)).vertices
    except (ValueError, RuntimeError, TypeError) as error:
        raise UserError(f"{path}: betas do not fit this hand model ({error}).") from None
    return Hands(vertices=vertices.numpy(), faces=hand.faces.numpy(), hand_pose=pose.numpy())
