"""The published GrabNet training data (ref. 2): poses are read, and what else it stores of a frame is recomputed."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from grabnet.body.hand import HandModel, HandParameters
from grabnet.data.objects import object_files
from grabnet.data.sources.base import FrameSource, HandFrames
from grabnet.data.splits import SPLITS
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, load_mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.io.files import existing
from grabnet.io.npz import npz_rows, read_npy, read_npz

log = logging.getLogger(__name__)

# Raise it when the same release would give other frames.
FORMAT = 1
# Frames read at a time from the arrays of vertices, which take tens of gigabytes.
_ROWS = 512
# Metres that stored vertices may lie off the hands that we make of the same parameters, or off the objects' meshes, on
# average: further, and model, meshes or conventions are others.
_TOLERANCE = 0.001
_HAND = {"global_orient_rhand_rotmat": (3, 3), "fpose_rhand_rotmat": (15, 3, 3), "trans_rhand": (3,)}
_OBJECT = {"root_orient_obj_rotmat": (3, 3), "trans_obj": (3,)}
# Ends the names of the noisy hands' arrays.
_NOISY = "_f"


class _Arrays(NamedTuple):
    """What one split of the release shows, a row per frame, in the world.

    true, noisy: hands; noisy is None where they are left out. rotations, transl: (N, 3, 3) and (N, 3) of the objects.
    """

    true: HandParameters
    noisy: HandParameters | None
    rotations: Tensor
    transl: Tensor


class GrabnetRelease(FrameSource):
    """The published data.

    Args:
        release: folder with the published `data` in it, or that folder itself.
        objects_dir: folder with a mesh for each object, such as GRAB's contact meshes.
        hand: the right hand that the data were made with, MANO's.
        noisy: keep the noisy hands, too, which RefineNet may start from (`StoredNoise`).

    Raises:
        UserError: here or when read: a file or array that is missing or misshapen; hands or objects that don't come
            out as stored.
    """

    def __init__(self, release: str, objects_dir: str, hand: HandModel, noisy: bool):
        self.release = Path(release)
        self.objects_dir = objects_dir
        self.hand = hand
        self.noisy = noisy
        self._mesh: Callable[[str], Mesh] = cache(lambda name: load_mesh(self._meshes[name]))
        self._split: tuple[str, _Arrays] | None = None  # read last: each takes gigabytes
        self._checks: dict[str, dict[str, dict[str, float]]] = {}

    def recipe(self) -> dict[str, Any]:
        return {
            "source": "published GrabNet data",
            "format": FORMAT,
            "frames": {split: len(names) for split, names in self._names.items()},
            "noisy": self.noisy,
        }

    def objects(self) -> Mapping[str, Path]:
        return self._meshes

    def subjects(self) -> Mapping[str, Tensor]:
        return self._subjects

    def sequences(self) -> Iterable[str]:
        return self._rows

    def read(self, sequence: str) -> HandFrames:
        split, rows = self._rows[sequence]
        names, arrays = self._names[split], self._arrays(split)
        first = names[rows[0]]
        return HandFrames(
            subject=first.subject,
            object=first.object,
            intent=first.action,
            frame=torch.tensor([names[row].frame for row in rows]),
            hand=arrays.true.select(rows),
            object_rotation=arrays.rotations[rows],
            object_transl=arrays.transl[rows],
            noisy=None if arrays.noisy is None else arrays.noisy.select(rows),
        )

    def facts(self) -> dict[str, Any]:
        """How far the stored hand vertices lie from those that we make of the stored poses, millimetres."""
        for split in SPLITS:
            if split not in self._checks:  # its shards were written by an earlier call
                self._arrays(split)
        return {"hand_vertices_mm": {split: self._checks[split] for split in SPLITS}}

    @cached_property
    def _folder(self) -> Path:
        folder = existing(self.release, "Published data (data.source.release)")
        return folder / "data" if (folder / "data").is_dir() else folder

    @cached_property
    def _names(self) -> dict[str, list[FrameName]]:
        return {split: read_frame_names(self._folder / split / "frame_names.npz") for split in SPLITS}

    @cached_property
    def _meshes(self) -> dict[str, Path]:
        return object_files(self.objects_dir)

    @cached_property
    def _subjects(self) -> dict[str, Tensor]:
        return read_subjects(self._folder / "sbj_info.npy", len(self.hand.v_template))

    @cached_property
    def _rows(self) -> dict[str, tuple[str, list[int]]]:
        """Split and rows of each sequence, in the order of its frames; one split after the other."""
        found: dict[str, tuple[str, list[int]]] = {}
        for split, names in self._names.items():
            for row in sorted(range(len(names)), key=lambda row: names[row].frame):
                sequence = names[row].sequence
                if found.setdefault(sequence, (split, []))[0] != split:
                    raise UserError(f"{self._folder}: {sequence} is in {found[sequence][0]} and in {split}.")
                found[sequence][1].append(row)
        return found

    def _arrays(self, split: str) -> _Arrays:
        """All frames of a split, compared with the vertices stored beside them."""
        if self._split is not None and self._split[0] == split:
            return self._split[1]
        self._split = None
        path, names = self._folder / split / f"grabnet_{split}.npz", self._names[split]
        for what, there, known in (("subjects", {n.subject for n in names}, self._subjects),
                                   ("objects", {n.object for n in names}, self._meshes)):  # fmt: skip
            if unknown := sorted(there - known.keys()):
                raise UserError(f"{path} shows {what} that are not known: {', '.join(unknown)}; there are {[*known]}.")
        hands, checks = {}, {}
        for kind, ending in ({"true": ""} | ({"noisy": _NOISY} if self.noisy else {})).items():
            arrays = (_parameters(path, name + ending, shape, len(names)) for name, shape in _HAND.items())
            hands[kind] = HandParameters(*arrays)
            off = checks[kind] = self._compare_hands(path, "verts_rhand" + ending, names, hands[kind])
            log.info("%s hands of %s come out %.4f mm off on average, %.4f at most.", kind, split, *off.values())
        turns, transl = (_parameters(path, name, shape, len(names)) for name, shape in _OBJECT.items())
        rotations = self._object_rotations(path, names, turns, transl)
        self._split = split, _Arrays(hands["true"], hands.get("noisy"), rotations, transl)
        self._checks[split] = checks
        return self._split[1]

    def _compare_hands(self, path: Path, array: str, names: list[FrameName], hand: HandParameters) -> dict[str, float]:
        """Mean and largest distance of an array's hand vertices to those of our model, millimetres."""
        v_template = torch.stack([*self._subjects.values()])
        number = {name: k for k, name in enumerate(self._subjects)}
        total, largest, start = 0.0, 0.0, 0
        for stored in npz_rows(path, array, _ROWS):
            part = slice(start, start + len(stored))
            rest = v_template[[number[name.subject] for name in names[part]]]
            if stored.shape[1:] != rest.shape[1:] or len(rest) < len(stored):
                raise UserError(f"{path}: {array} has rows {stored.shape}, expected {tuple(rest.shape)}.")
            apart = (self.hand(hand.select(part), rest).vertices - torch.tensor(stored)).norm(dim=-1)
            total, largest, start = total + apart.mean(1).sum().item(), max(largest, apart.max().item()), part.stop
        if not total / len(names) < _TOLERANCE:
            raise UserError(
                f"{path}: hands made of its poses lie {1e3 * total / len(names):.1f} mm off its {array}: pass the "
                f"model that they were made with, hand_model=mano hand_model.path=<MANO_RIGHT.npz>."
            )
        return {"mean": 1e3 * total / len(names), "max": 1e3 * largest}

    def _object_rotations(self, path: Path, names: list[FrameName], stored: Tensor, transl: Tensor) -> Tensor:
        """(N, 3, 3) from the objects' frames to the world.

        GRAB turns row vectors; whether these matrices are to be read so or for column vectors, the stored object
        points tell.
        """
        queries = cache(lambda name: MeshQuery(self._mesh(name)))
        off = {"rows": [], "columns": []}
        for k, points in enumerate(npz_rows(path, "verts_object", _ROWS)):
            row = k * _ROWS
            local = torch.tensor(points[0]) - transl[row]
            for kind, turned in (("rows", local @ stored[row].T), ("columns", local @ stored[row])):
                off[kind].append(queries(names[row].object).closest(turned).distance.mean().item())
        kind = min(off, key=lambda kind: np.mean(off[kind]))
        if not max(off[kind]) < _TOLERANCE:
            raise UserError(
                f"{path}: its object points lie {1e3 * max(off[kind]):.1f} mm off the meshes of objects.dir: pass the "
                f"meshes that they were made with."
            )
        return stored.mT if kind == "rows" else stored


@dataclass(frozen=True)
class FrameName:
    """What the name of a published frame says: `…/s1/mug_pass_1/00123.npz`."""

    subject: str
    take: str
    frame: int

    @property
    def sequence(self) -> str:
        return f"{self.subject}/{self.take}"

    @property
    def object(self) -> str:
        return self.take.split("_")[0]

    @property
    def action(self) -> str:
        return self.take.partition("_")[2].rpartition("_")[0]


def read_frame_names(path: Path) -> list[FrameName]:
    """Names in a `frame_names.npz`.

    Raises:
        UserError: not one array of text, or names of another form.
    """
    arrays = [np.asarray(array) for array in read_npz(path).values()]
    if len(arrays) != 1 or arrays[0].ndim != 1:
        raise UserError(f"{path} holds {len(arrays)} arrays, expected one list of frame names.")
    names = []
    for text in arrays[0]:
        *_, subject, take, file = ("", "", "", *PurePosixPath(str(text)).parts)
        if not (subject and take.count("_") >= 2 and file.removesuffix(".npz").isdecimal()):
            raise UserError(f"{path}: '{text}' is no frame name like …/s1/mug_pass_1/00123.npz.")
        names.append(FrameName(subject, take, int(file.removesuffix(".npz"))))
    return names


def read_subjects(path: Path, n_vertices: int) -> dict[str, Tensor]:
    """(V, 3) right hand of each subject, from `sbj_info.npy`.

    Raises:
        UserError: no dict of subjects, or a hand that is missing or misshapen.
    """
    stored = read_npy(path)
    if not isinstance(stored, dict):
        raise UserError(f"{path} holds a {type(stored).__name__}, expected a dict of subjects.")
    hands = {}
    for name, facts in stored.items():
        v_template = np.asarray(facts.get("rh_vtemp") if isinstance(facts, dict) else None)
        if v_template.shape != (n_vertices, 3):
            raise UserError(f"{path}: rh_vtemp of {name} has shape {v_template.shape}, expected ({n_vertices}, 3).")
        hands[str(name)] = torch.as_tensor(v_template, dtype=torch.float32)
    return hands


def _parameters(path: Path, name: str, shape: tuple[int, ...], n: int) -> Tensor:
    """(n, *shape) of an array whose rows may have a further axis of one."""
    values = np.concatenate(list(npz_rows(path, name, _ROWS)))
    if len(values) != n or values[0].size != np.prod(shape) or not np.isfinite(values).all():
        raise UserError(f"{path}: {name} is of shape {values.shape}, or not finite; expected {(n, *shape)}.")
    return torch.tensor(values, dtype=torch.float32).reshape(n, *shape)
