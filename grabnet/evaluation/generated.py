"""Grasps to evaluate: drawn from trained networks, or made elsewhere and read from a folder.

A folder holds one folder for each object, called like it, with either of

- `grasps.npz`, as `scripts/sample.py` writes it: global_orient (N, 3) and hand_pose (N, 45) axis-angle, radians,
  flat_hand_mean; transl (N, 3) metres; betas (N, n), and optionally side;
- hand meshes, `*.ply` or `*.obj` (also stl, off, glb), taken in the order of their names, all of one topology, each
  vertex number the same point of the hand.

Hands lie in the frame of the object's mesh in the data set, metres; those of a size that no hand has, or farther from
the object than a hand is long, are refused. Meshes with as many vertices as the hand model are
taken to have its vertices; of others, what needs to know the fingers is not measured.
"""

from __future__ import annotations

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
from grabnet.geometry.mesh import Mesh, load_mesh, read_mesh
from grabnet.geometry.openings import boundary_loops
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.io.files import existing, sha256
from grabnet.io.names import originals
from grabnet.io.npz import read_npz
from grabnet.io.state import read_json

GRASPS = "grasps.npz"
_PARAMETERS = {"transl": 3, "global_orient": 3, "hand_pose": 45}
# Metres: sides of the boxes around a child's fist and a stretched hand with a wrist, with room to spare.
_SMALLEST, _LARGEST = 0.03, 0.5
# Metres between the boxes around hand and object: more than a hand's length is no failed grasp, but another frame.
_FARTHEST = 0.25
_UNITS = {"millimetres": 1000, "centimetres": 100, "decimetres": 10}


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

    sizes = f"{n} {seed} {grabber.settings} {grabber.finger.device.type}"
    arrays = cache.get("drawn", [*sources, mesh.sha256, grabber.hand.fingerprint, sizes], draw)
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
        UserError: grasps that cannot be read, or that were made for another mesh of this name or with another hand.
    """
    place = existing(folder, "Folder of grasps") / name
    if not place.is_dir():
        return None
    if (place / GRASPS).exists():
        _check_record(place, file, hand)
        hands, sources = _posed(place / GRASPS, hand, n), [place / GRASPS]
    else:
        hands, sources = _meshed(place, n)
    _check_hands(hands.vertices, sources, load_mesh(file), file)
    return hands


def _meshed(place: Path, n: int) -> tuple[Hands, list[Path]]:
    """The first n hand meshes of a folder, and their files."""
    files = [p for p in originals(place.iterdir(), place) if p.suffix.lower() in MESH_SUFFIXES and p.is_file()][:n]
    if not files:
        raise UserError(f"{place} holds neither {GRASPS} nor hand meshes ({', '.join(MESH_SUFFIXES)}).")
    meshes = [read_mesh(f, weld=False, mend=False) for f in files]
    for path, mesh in zip(files, meshes, strict=True):
        if mesh.vertices.shape != meshes[0].vertices.shape or not np.array_equal(mesh.faces, meshes[0].faces):
            raise UserError(f"{path} has other vertices or faces than {files[0]}: all hands must share one topology.")
    faces = load_mesh(files[0], weld=False).faces
    try:
        boundary_loops(faces)
    except ValueError as error:
        raise UserError(f"{files[0]} cannot be closed at the wrist: {error}.") from None
    return Hands(vertices=np.stack([m.vertices for m in meshes]), faces=faces.astype(np.int64)), files


def _check_hands(vertices: np.ndarray, sources: Sequence[Path], mesh: Mesh, file: Path) -> None:
    """Raise a `UserError` for the first hand that is none in metres, in the frame of the object's mesh.

    Args:
        vertices: (N, V, 3).
        sources: file of each hand, or the one of all.
        mesh: the object.
        file: of its mesh.
    """
    low, high = vertices.min(1).astype(np.float64), vertices.max(1).astype(np.float64)
    sides = (high - low).max(1)
    gaps = np.linalg.norm(np.maximum(0, np.maximum(low - mesh.bounds[1], mesh.bounds[0] - high)), axis=1)
    good = (sides >= _SMALLEST) & (sides <= _LARGEST) & (gaps <= _FARTHEST)  # NaN is not
    if good.all():
        return
    i = int((~good).argmax())
    name = f"{sources[0]}: grasp {i}" if len(sources) == 1 else str(sources[i])
    if not np.isfinite([sides[i], gaps[i]]).all():
        raise UserError(f"{name} has vertices that are not finite: repair the grasp, or leave it out.")
    if not _SMALLEST <= sides[i] <= _LARGEST:
        fits = [f"divide by {k} if it is in {unit}" for unit, k in _UNITS.items() if 0.07 < sides[i] / k < 0.3]
        remedy = " or ".join(fits) or "check its pose, shape and units"
        raise UserError(f"{name} has a largest side of {sides[i]:.4g} m, which no hand has: {remedy}.")
    fits = [f"divide transl by {k} if it is in {unit}" for unit, k in _UNITS.items() if gaps[i] / k < _FARTHEST]
    units = f", and {' or '.join(fits)}" if sources[0].name == GRASPS and fits else ""
    raise UserError(
        f"{name} is {gaps[i]:.4g} m away from the object: give hands in metres, in the frame of {file}{units}; leave "
        "out those that are no grasps."
    )


def _check_record(place: Path, file: Path, hand: HandModel) -> None:
    """Grasps that say which mesh and which hand they are of must be of the data set's."""
    record = place / "grasps.json"
    if not record.exists():
        return
    kind = {"mesh_sha256?": (str, None), "hand_sha256?": (str, None)}
    said = read_json(record, kind, "remove it, or make the grasps again")
    made_for, posed = said.get("mesh_sha256"), said.get("hand_sha256")
    if made_for not in (None, sha256(file)):
        raise UserError(f"The grasps in {place} were made for another mesh than {file}: make them for that one.")
    if posed is not None and not hand.is_named_by(posed):
        raise UserError(
            f"The grasps in {place} are poses of another hand model: give them as meshes, or evaluate with data and "
            "hand_model of that hand."
        )


def _posed(path: Path, hand: HandModel, n: int) -> Hands:
    values = read_npz(path)
    if missing := [name for name in _PARAMETERS if name not in values]:
        raise UserError(f"{path} has no {', '.join(missing)}; it needs {', '.join(_PARAMETERS)} and betas.")
    side = str(values.get("side", "right"))
    if side != ("right" if hand.is_right else "left"):
        raise UserError(f"{path} holds {side!r} hands, which this hand model does not pose: give them as meshes.")
    arrays = {name: np.asarray(values[name]) for name in _PARAMETERS}
    count = len(np.atleast_1d(arrays["transl"]))
    arrays["betas"] = np.asarray(values.get("betas", np.zeros((count, 1))))
    most = hand.shapedirs.shape[-1]
    tensors = {}
    for name, array in arrays.items():
        width = _PARAMETERS.get(name)
        fits = (
            array.ndim == 2 and len(array) == count and (array.shape[1] == width if width else array.shape[1] <= most)
        )
        if not fits or array.dtype.kind not in "fiu":
            needed = width or f"up to {most}"
            raise UserError(f"{path}: {name} has shape {array.shape}; (N, {needed}) finite numbers are needed.")
        with np.errstate(over="ignore"):
            array = array[:n].astype(np.float32)
        if not (finite := np.isfinite(array).all(1)).all():
            raise UserError(
                f"{path}: {name} of grasp {finite.argmin()} are not all finite numbers: repair it, or leave it out."
            )
        tensors[name] = torch.as_tensor(array)
    if not count:
        raise UserError(f"{path} holds no grasp.")
    pose = axis_angle_to_matrix(tensors["hand_pose"].unflatten(1, (15, 3)))
    parameters = HandParameters(axis_angle_to_matrix(tensors["global_orient"]), pose, tensors["transl"])
    vertices = hand(parameters, hand.shaped(tensors["betas"])).vertices
    return Hands(vertices=vertices.numpy(), faces=hand.faces.numpy(), hand_pose=pose.numpy())
