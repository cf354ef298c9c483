"""A data set as right hands on objects, and the one way to write such hands into a frames store.

Another data set is one class: a `FrameSource`. Named under `data.source` in a config, it is written on first use.
"""

from __future__ import annotations

import shutil
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import torch
from filelock import FileLock
from rich.progress import track
from torch import Tensor

from grabnet.body.hand import HandModel, HandParameters
from grabnet.data.frames import FORMAT, finish_store, read_header, shard_names, shard_path, start_store, write_shard
from grabnet.data.objects import OBJECT_MESHES
from grabnet.errors import UserError
from grabnet.geometry.mesh import load_mesh
from grabnet.geometry.rotations import matrix_to_axis_angle
from grabnet.io.files import replacing
from grabnet.io.provenance import versions

# Largest error of R Rᵀ = 1 that rounding explains.
_ORTHOGONAL = 1e-3


class HandFrames(NamedTuple):
    """N right hands of one subject on one object; metres, in a world with z up.

    subject: name of whose hand it is, a key of `FrameSource.subjects`.
    object: name of what it is on, a key of `FrameSource.objects`.
    intent: the action, as in "drink", "pass" or "lift": what GRAB calls motion_intent.
    frame: (N,) int64 frame numbers in the sequence.
    hand: parameters of the N hands in the world.
    object_rotation: (N, 3, 3) orthogonal, from the object's frame to the world's, for column vectors.
    object_transl: (N, 3) metres, added after rotating about the origin of the object's frame.
    noisy: parameters of other hands near the true ones, in the world; None where the data set has none.
    """

    subject: str
    object: str
    intent: str
    frame: Tensor
    hand: HandParameters
    object_rotation: Tensor
    object_transl: Tensor
    noisy: HandParameters | None = None


class FrameSource(ABC):
    """A data set as right hands on objects.

    Attributes:
        hand: the right hand that its poses are for.
    """

    hand: HandModel

    @abstractmethod
    def recipe(self) -> dict[str, Any]:
        """All that decides the frames, JSON-able: settings, hashes, and a FORMAT that changes of the code raise."""

    @abstractmethod
    def objects(self) -> Mapping[str, Path]:
        """Mesh file of each object, by name; metres, in the frame that `HandFrames.object_rotation` starts from."""

    @abstractmethod
    def subjects(self) -> Mapping[str, Tensor]:
        """(V, 3) rest right hand of each subject, by name, metres: the template, or `hand.shaped(betas)`."""

    @abstractmethod
    def sequences(self) -> Iterable[str]:
        """Names of all sequences, `<subject>/<object>_<action>_<k>`, in the order in which they are read best."""

    @abstractmethod
    def read(self, sequence: str) -> HandFrames:
        """The frames of one sequence."""

    def facts(self) -> dict[str, Any]:
        """Further facts for the store's card, JSON-able; asked for when all frames are written."""
        return {}


def write_store(root: Path, source: FrameSource) -> None:
    """Write the frames store of a source and the meshes of its objects, unless they are there.

    A killed call continues where it stopped and ends in the same bytes. Of several calls at the same time one writes,
    and the others wait.

    Args:
        root: of the data set: the store is its folder `frames`, and meshes lie where GRAB has its own.
        source: what to write.

    Raises:
        UserError: the store there was started with another recipe, or frames that name an unknown subject or object,
            are not finite, or have no rotations.
    """
    store = root / "frames"
    recipe = {"store": FORMAT, "hand_sha256": source.hand.fingerprint} | source.recipe()
    remedy = f"delete {store}, or choose another data.root"
    if (store / "store.json").exists():  # complete: nothing is written, which may be forbidden
        return start_store(store, recipe, remedy)
    store.mkdir(parents=True, exist_ok=True)
    with FileLock(store / ".lock"):
        start_store(store, recipe, remedy)
        if not (store / "store.json").exists():
            _write(root, store, source, recipe)


def _write(root: Path, store: Path, source: FrameSource, recipe: dict[str, Any]) -> None:
    meshes, subjects = source.objects(), source.subjects()
    centroid = cache(lambda name: torch.as_tensor(load_mesh(meshes[name]).centroid, dtype=torch.float32))
    done = set(shard_names(store))
    for sequence in track(list(source.sequences()), "Writing the frames", transient=True):
        if sequence in done:
            continue
        frames = source.read(sequence)
        for what, name, known in (("subject", frames.subject, subjects), ("object", frames.object, meshes)):
            if name not in known:
                raise UserError(f"{sequence} shows the {what} {name}, which is unknown; there are {', '.join(known)}.")
        write_frames(store, sequence, frames, centroid(frames.object))
    shown = sorted({read_header(shard_path(store, name))["object"] for name in shard_names(store)})
    facts = {
        "recipe": recipe,
        "versions": versions(),
        "objects_sha256": {name: place_mesh(root, name, meshes[name]) for name in shown},
    }
    finish_store(store, source.hand.fingerprint, dict(subjects), shown, facts | source.facts())


def write_frames(store: Path, sequence: str, frames: HandFrames, centroid: Tensor, **header: Any) -> None:
    """Write one sequence as a shard of a store.

    Args:
        store: its folder.
        sequence: name, `<subject>/<object>_<action>_<k>`.
        frames: what to write.
        centroid: (3,) metres, mean vertex of the object's mesh, in the object's frame.
        header: further facts that JSON can say.

    Raises:
        UserError: a name that is no path of two parts, or values that are not finite or no rotations.
    """
    if sequence.count("/") != 1 or any(not part or part.startswith(".") for part in sequence.split("/")):
        raise UserError(f"'{sequence}' cannot name a sequence: it must be like s1/mug_lift_1.")
    for hand in filter(None, (frames.hand, frames.noisy)):
        _check(sequence, "hand", hand.rotations, hand.transl)
    _check(sequence, "object", frames.object_rotation, frames.object_transl)
    values = shard_values(frames, centroid)
    write_shard(store, sequence, frames.subject, frames.object, values, intent=frames.intent, **header)


def shard_values(frames: HandFrames, centroid: Tensor) -> dict[str, Tensor]:
    """Values of a shard: about the object's centroid, with the heading kept (ref. 3), rotations as axis-angle.

    Args:
        frames: in the world.
        centroid: (3,) metres, in the object's frame.
    """
    origin = frames.object_rotation @ centroid + frames.object_transl
    values = _about(frames.hand, origin) | {
        "object_orient": matrix_to_axis_angle(frames.object_rotation),
        "frame": frames.frame,
    }
    if frames.noisy is not None:
        values["noisy"] = torch.cat([*_about(frames.noisy, origin).values()], 1)
    return values


def place_mesh(root: Path, name: str, source: Path) -> str:
    """Copy an object's mesh to where training looks for it below `root`; its `Mesh.sha256`."""
    target = root / OBJECT_MESHES / f"{name}{source.suffix}"
    if target.resolve() != source.resolve():
        with replacing(target) as temporary:
            shutil.copyfile(source, temporary)
    return load_mesh(target).sha256


def _about(hand: HandParameters, origin: Tensor) -> dict[str, Tensor]:
    """Hands as a shard has them, about (N, 3) origins."""
    return {
        "global_orient": matrix_to_axis_angle(hand.global_orient),
        "hand_pose": matrix_to_axis_angle(hand.hand_pose).flatten(1),
        "transl": hand.transl - origin,
    }


def _check(sequence: str, what: str, rotations: Tensor, transl: Tensor) -> None:
    """Raise a `UserError` for rotations (..., 3, 3) or translations (N, 3) that are none."""
    if not (rotations.isfinite().all() and transl.isfinite().all()):
        raise UserError(f"{sequence}: its {what} is not finite in some frame.")
    off = (rotations @ rotations.mT - torch.eye(3, dtype=rotations.dtype)).abs().amax() if len(rotations) else 0
    if off > _ORTHOGONAL or (rotations.det() < 0).any():
        raise UserError(f"{sequence}: the rotations of its {what} are no rotation matrices (off by {off:.2g}).")
