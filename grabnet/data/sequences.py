"""GRAB's recordings: one `.npz` per sequence, read and written with every field checked (ref. 1).

Frames are metres and radians, z up, 120 per second. Two traps of the format are dealt with here and nowhere else: the
object's rotation acts on row vectors, and the exact hand pose is `fullpose`, while `hand_pose` approximates it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import torch
from torch import Tensor

from grabnet.body.hand import HandParameters
from grabnet.body.skeleton import JOINTS, N_PARTS
from grabnet.body.whole import BodyParameters
from grabnet.data.names import is_plain, read_text
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, load_mesh
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.io.files import replacing
from grabnet.io.npz import read_npz


@dataclass(frozen=True)
class RigidTrack:
    """Motion of a rigid thing.

    transl, global_orient: (T, 3), acting on row vectors: x @ R(global_orient) + transl. mesh: path below GRAB's root.
    """

    transl: np.ndarray
    global_orient: np.ndarray
    mesh: str

    def rotations(self, frames: np.ndarray | slice = slice(None)) -> Tensor:
        """(N, 3, 3) rotations from the thing's own frame to the world's, for column vectors as everywhere else."""
        return axis_angle_to_matrix(_tensor(self.global_orient[frames])).mT

    def to_world(self, points: Tensor, frames: np.ndarray | slice = slice(None)) -> Tensor:
        """Points (P, 3) of the thing's own frame in the world, (N, P, 3)."""
        return points @ self.rotations(frames).mT + _tensor(self.transl[frames]).unsqueeze(1)

    def to_local(self, points: Tensor, frames: np.ndarray | slice = slice(None)) -> Tensor:
        """Points (N, P, 3) of the world, frame by frame, in the thing's own frame."""
        return (points - _tensor(self.transl[frames]).unsqueeze(1)) @ self.rotations(frames)


@dataclass(frozen=True)
class HandTrack:
    """Motion of a hand in MANO's parameters.

    global_orient, transl: (T, 3). fullpose: (T, 45) axis-angle, exact, on a flat mean. hand_pose: (T, n_comps)
    principal components on a flat mean, which approximate it. vtemp: path of the subject's template below GRAB's root.
    """

    global_orient: np.ndarray
    hand_pose: np.ndarray
    transl: np.ndarray
    fullpose: np.ndarray
    vtemp: str

    def parameters(self, frames: np.ndarray | slice = slice(None)) -> HandParameters:
        """Exact poses in the world's frame."""
        return HandParameters(
            axis_angle_to_matrix(_tensor(self.global_orient[frames])),
            axis_angle_to_matrix(_tensor(self.fullpose[frames]).unflatten(1, (15, 3))),
            _tensor(self.transl[frames]),
        )


@dataclass(frozen=True)
class BodyTrack:
    """Motion of the whole body in SMPL-X's parameters.

    fullpose: (T, 165) axis-angle of all joints, exact; the hands' (T, n_comps) components, about the model's mean
    hand, approximate theirs.
    expression: (T, 10). vtemp: path of the subject's template below GRAB's root, which replaces betas.
    """

    transl: np.ndarray
    global_orient: np.ndarray
    body_pose: np.ndarray
    jaw_pose: np.ndarray
    leye_pose: np.ndarray
    reye_pose: np.ndarray
    left_hand_pose: np.ndarray
    right_hand_pose: np.ndarray
    fullpose: np.ndarray
    expression: np.ndarray
    vtemp: str

    def parameters(self, frames: np.ndarray | slice = slice(None)) -> BodyParameters:
        """Exact poses in the world's frame."""
        rotations = axis_angle_to_matrix(_tensor(self.fullpose[frames]).unflatten(1, (len(JOINTS), 3)))
        return BodyParameters.from_rotations(rotations, _tensor(self.transl[frames]))


@dataclass(frozen=True)
class ContactTrack:
    """Which part touches, 0 for none. object: (T, V of the object), body: (T, V of the body), uint8."""

    object: np.ndarray
    body: np.ndarray


@dataclass(frozen=True)
class Sequence:
    """One recording of T frames.

    Attributes:
        name: `<subject>/<object>_<action>_<k>`, from the file's place.
        gender, sbj_id, obj_name: as stored.
        motion_intent: the action, as in "drink", "pass" or "lift"; see `grabnet.data.intents.intent_of`.
        framerate: frames per second.
        n_comps: principal components of a hand pose.
    """

    name: str
    gender: str
    sbj_id: str
    obj_name: str
    motion_intent: str
    framerate: float
    n_comps: int
    body: BodyTrack
    rhand: HandTrack
    lhand: HandTrack
    object: RigidTrack
    table: RigidTrack
    contact: ContactTrack

    def __len__(self) -> int:
        return len(self.object.transl)


@dataclass(frozen=True)
class _Stored:
    """How a track lies in the file: widths of its params (C: n_comps) and the key of the path beside them."""

    kind: type
    widths: dict[str, int | str]
    path: str


_HAND = _Stored(HandTrack, {"global_orient": 3, "hand_pose": "C", "transl": 3, "fullpose": 45}, "vtemp")
_POSES = {"transl": 3, "global_orient": 3, "body_pose": 63, "jaw_pose": 3, "leye_pose": 3, "reye_pose": 3}
_TRACKS = {
    "body": _Stored(
        BodyTrack,
        _POSES | {"left_hand_pose": "C", "right_hand_pose": "C", "fullpose": 165, "expression": 10},
        "vtemp",
    ),
    "rhand": _HAND,
    "lhand": _HAND,
    "object": _Stored(RigidTrack, {"transl": 3, "global_orient": 3}, "object_mesh"),
    "table": _Stored(RigidTrack, {"transl": 3, "global_orient": 3}, "table_mesh"),
}
_TEXTS = ("gender", "sbj_id", "obj_name", "motion_intent")
_NUMBERS = ("framerate", "n_comps", "n_frames")
# Characters of a name, and of a path.
_LONGEST_TEXT, _LONGEST_PATH = 100, 1000


def read_sequence(path: str | Path, objects: Iterable[str] | None = None) -> Sequence:
    """Read and check one sequence file; pickled dicts are decoded without running anything.

    Args:
        path: `<root>/grab/<subject>/<object>_<action>_<k>.npz`.
        objects: names of those that have a mesh, such as `object_files(folder)`; any when omitted.

    Raises:
        UserError: unreadable; a missing key; a wrong shape; values that are not finite; numbers of frames that differ;
            an unknown object; labels beyond 0 … 55; a path that leads out of GRAB's root.
    """
    path = Path(path)
    stored = read_npz(path)
    _require(path, "the file", stored, (*_TRACKS, *_TEXTS, *_NUMBERS, "contact"))
    texts = {name: read_text(path, name, stored[name], _LONGEST_TEXT) for name in _TEXTS}
    for name in ("sbj_id", "obj_name"):
        if not is_plain(texts[name]):
            raise UserError(f"{path}: {name} is '{texts[name]}', which is no plain name.")
    numbers = {name: _number(path, name, stored[name]) for name in _NUMBERS}
    n_frames, n_comps = int(numbers["n_frames"]), int(numbers["n_comps"])
    if (n_frames, n_comps) != (numbers["n_frames"], numbers["n_comps"]):
        raise UserError(f"{path}: n_frames or n_comps is no whole number.")
    if objects is not None and texts["obj_name"] not in set(objects):
        known = ", ".join(sorted(objects))
        raise UserError(f"{path} shows '{texts['obj_name']}', an object without a mesh; there are {known or 'none'}.")
    return Sequence(
        name=f"{path.parent.name}/{path.stem}",
        **texts,
        framerate=numbers["framerate"],
        n_comps=n_comps,
        **{name: _read_track(path, name, stored[name], n_frames, n_comps) for name in _TRACKS},
        contact=_read_contact(path, stored["contact"], n_frames),
    )


def write_sequence(path: str | Path, sequence: Sequence) -> None:
    """Write `sequence` as GRAB stores it, atomically; `read_sequence` reads the same back."""
    content: dict[str, Any] = {name: getattr(sequence, name) for name in (*_TEXTS, "framerate", "n_comps")}
    content |= {"n_frames": len(sequence)}
    for name, stored in _TRACKS.items():
        *values, path_below = vars(getattr(sequence, name)).values()
        content[name] = {"params": dict(zip(stored.widths, values, strict=True)), stored.path: path_below}
    content["contact"] = {"object": sequence.contact.object, "body": sequence.contact.body}
    arrays = {k: np.array(v, dtype=object) if isinstance(v, dict) else np.array(v) for k, v in content.items()}
    with replacing(path) as temporary:
        np.savez_compressed(temporary, **arrays)


def load_below(root: str | Path, relative: str, mend: bool = True) -> Mesh:
    """A template or mesh that a sequence names, its vertices as numbered in the file.

    Args:
        mend: as of `read_mesh`; False for templates, of which only the vertices count.

    Raises:
        UserError: it lies outside `root`, links included, or is unreadable.
    """
    path, root = Path(root) / _inside(relative, "The path of a mesh"), Path(root).resolve()
    if not path.resolve().is_relative_to(root):
        raise UserError(f"{relative} leads out of {root}, which is not followed: put the file itself there.")
    return load_mesh(path, weld=False, mend=mend)


def _read_track(path: Path, name: str, content: Any, n_frames: int, n_comps: int) -> Any:
    stored = _TRACKS[name]
    if not isinstance(content, dict):
        raise UserError(f"{path}: {name} is a {type(content).__name__}, where GRAB stores a dict.")
    _require(path, name, content, ("params", stored.path))
    _require(path, f"params of {name}", content["params"], stored.widths)
    values = {
        key: _frames(path, f"{name} {key}", content["params"][key], n_frames, n_comps if width == "C" else width)
        for key, width in stored.widths.items()
    }
    relative = read_text(path, f"{name} {stored.path}", content[stored.path], _LONGEST_PATH)
    return stored.kind(*values.values(), _inside(relative, f"{path}: {name} {stored.path}"))


def _read_contact(path: Path, stored: Any, n_frames: int) -> ContactTrack:
    if not isinstance(stored, dict):
        raise UserError(f"{path}: contact is a {type(stored).__name__}, where GRAB stores a dict.")
    _require(path, "contact", stored, ("object", "body"))
    labels = {}
    for name in ("object", "body"):
        array = np.asarray(stored[name])
        if array.ndim != 2 or array.dtype.kind not in "biu":
            raise UserError(f"{path}: contact {name} is {array.dtype} of shape {array.shape}, expected ints (T, V).")
        _check_length(path, f"contact {name}", len(array), n_frames)
        if array.size and not 0 <= array.min() <= array.max() <= N_PARTS:
            raise UserError(
                f"{path}: contact {name} has labels {array.min()} … {array.max()}; parts are numbered 0 … {N_PARTS}."
            )
        labels[name] = array.astype(np.uint8)
    return ContactTrack(**labels)


def _require(path: Path, where: str, stored: Any, keys: Iterable[str]) -> None:
    there = stored if isinstance(stored, dict) else {}
    if missing := [key for key in keys if key not in there]:
        raise UserError(f"{path} lacks {', '.join(missing)} in {where}: it is no sequence in GRAB's format.")


def _number(path: Path, name: str, value: Any) -> float:
    array = np.asarray(value)
    if array.size != 1 or array.dtype.kind not in "iuf" or not 0 < array.item() < np.inf:
        raise UserError(f"{path}: {name} is {str(array)[:80]}, expected a positive number.")
    return float(array.item())


def _frames(path: Path, name: str, value: Any, n_frames: int, width: int) -> np.ndarray:
    array = np.asarray(value)
    if array.ndim != 2 or array.shape[1] != width or array.dtype.kind not in "fiu":
        raise UserError(
            f"{path}: {name} is {array.dtype} of shape {array.shape}, expected numbers ({n_frames}, {width})."
        )
    _check_length(path, name, len(array), n_frames)
    if bad := int((~np.isfinite(array)).any(1).sum()):
        first = int((~np.isfinite(array)).any(1).argmax())
        raise UserError(f"{path}: {name} is not finite in {bad} of {n_frames} frames, first in frame {first}.")
    return array.astype(np.float32)


def _check_length(path: Path, name: str, length: int, n_frames: int) -> None:
    if length != n_frames:
        raise UserError(f"{path}: {name} has {length} frames, n_frames says {n_frames}.")


def _inside(relative: str, name: str) -> str:
    parts = PurePosixPath(relative.replace("\\", "/"))
    if parts.is_absolute() or ".." in parts.parts or ":" in relative or not relative:
        raise UserError(f"{name} is '{relative}', which leads out of GRAB's root: it must be a path below it.")
    return relative


def _tensor(array: np.ndarray) -> Tensor:
    return torch.as_tensor(array, dtype=torch.float32)
