"""The published GrabNet training data (ref. 2) as a frames store: what it stores per frame, we recompute."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath

import numpy as np
import torch
from rich.progress import track
from torch import Tensor

from grabnet.body.hand import HandModel, HandParameters
from grabnet.data.frames import finish_store, is_made_by, write_shard
from grabnet.data.objects import object_files
from grabnet.data.splits import SPLITS
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, load_mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.rotations import matrix_to_axis_angle
from grabnet.io.files import existing, sha256
from grabnet.io.npz import npz_rows, read_npy, read_npz
from grabnet.io.provenance import provenance

log = logging.getLogger(__name__)

# Frames read at a time from the arrays of vertices, which take tens of gigabytes.
_ROWS = 512
# Metres that stored vertices may lie off the hands that we make of the same parameters, or off the objects' meshes, on
# average: further, and model, meshes or conventions are others.
_TOLERANCE = 0.001
_HAND = {"global_orient_rhand_rotmat": (3, 3), "fpose_rhand_rotmat": (15, 3, 3), "trans_rhand": (3,)}
_OBJECT = {"root_orient_obj_rotmat": (3, 3), "trans_obj": (3,)}
# Ends the names of the noisy hands' arrays.
_NOISY = "_f"


class GrabnetRelease:
    """Writes the frames store of the published data when called, unless it is there.

    Args:
        release: folder with the published `data` in it, or that folder itself.
        root: of the data set to write: the store is its folder `frames`.
        objects_dir: folder with a mesh for each object, such as GRAB's contact meshes.
        hand: the right hand that the data were made with, MANO's.
        noisy: keep the noisy hands, too, which RefineNet may start from (`StoredNoise`).
    """

    def __init__(self, release: str, root: str, objects_dir: str, hand: HandModel, noisy: bool):
        self.release, self.root, self.hand, self.noisy = Path(release), Path(root), hand, noisy
        self.meshes = object_files(objects_dir)
        self._mesh: Callable[[str], Mesh] = cache(lambda name: load_mesh(self.meshes[name]))

    def __call__(self) -> None:
        """Convert.

        Raises:
            UserError: a file or array that is missing or misshapen; hands or objects that don't come out as stored.
        """
        folder = existing(self.release, "Published data (data.prepare.release)")
        folder = folder / "data" if (folder / "data").is_dir() else folder
        names = {split: read_frame_names(folder / split / "frame_names.npz") for split in SPLITS}
        recipe = {
            "frames": {split: len(frames) for split, frames in names.items()},
            "hand_sha256": sha256(self.hand.v_template.numpy()),
            "noisy": self.noisy,
        }
        if is_made_by(self.root / "frames", recipe):
            return
        subjects = read_subjects(folder / "sbj_info.npy", len(self.hand.v_template))
        checks = {split: self._convert(folder / split, frames, subjects) for split, frames in names.items()}
        for split, hands in checks.items():
            for name, off in hands.items():
                log.info("%s hands of %s come out %.4f mm off on average, %.4f at most.", name, split, *off.values())
        objects = {frame.object for frames in names.values() for frame in frames}
        facts = provenance(source="published GrabNet data", recipe=recipe, hand_vertices_mm=checks)
        finish_store(self.root / "frames", subjects, objects, facts)

    def _convert(
        self, folder: Path, names: list[FrameName], subjects: dict[str, Tensor]
    ) -> dict[str, dict[str, float]]:
        """Write the shards of a split; how far its hands' vertices lie from ours."""
        path = folder / f"grabnet_{folder.name}.npz"
        for what, there, known in (("subjects", {n.subject for n in names}, subjects),
                                   ("objects", {n.object for n in names}, self.meshes)):  # fmt: skip
            if unknown := sorted(there - known.keys()):
                raise UserError(f"{path} shows {what} that are not known: {', '.join(unknown)}; there are {[*known]}.")
        kinds = {"true": ""} | ({"noisy": _NOISY} if self.noisy else {})
        hands, checks = {}, {}
        for kind, ending in kinds.items():
            arrays = (_parameters(path, name + ending, shape, len(names)) for name, shape in _HAND.items())
            hands[kind] = HandParameters(*arrays)
            checks[kind] = self._compare_hands(path, "verts_rhand" + ending, names, hands[kind], subjects)
        turns, places = (_parameters(path, name, shape, len(names)) for name, shape in _OBJECT.items())
        rotations = self._object_rotations(path, names, turns, places)
        rows_of: dict[str, list[int]] = {}
        for row in sorted(range(len(names)), key=lambda row: names[row].frame):
            rows_of.setdefault(names[row].sequence, []).append(row)
        for sequence, rows in track(rows_of.items(), f"Writing {folder.name}", transient=True):
            first = names[rows[0]]
            origin = rotations[rows] @ torch.tensor(self._mesh(first.object).centroid) + places[rows]
            shard = _about(hands["true"].select(rows), origin) | {
                "object_orient": matrix_to_axis_angle(rotations[rows]),
                "frame": torch.tensor([names[row].frame for row in rows]),
            }
            if self.noisy:
                shard["noisy"] = torch.cat([*_about(hands["noisy"].select(rows), origin).values()], 1)
            write_shard(self.root / "frames", sequence, first.subject, first.object, shard, intent=first.action)
        return checks

    def _compare_hands(
        self, path: Path, array: str, names: list[FrameName], hand: HandParameters, subjects: dict[str, Tensor]
    ) -> dict[str, float]:
        """Mean and largest distance of an array's hand vertices to those of our model, millimetres."""
        v_template, number = torch.stack([*subjects.values()]), {name: k for k, name in enumerate(subjects)}
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


def _about(hand: HandParameters, origin: Tensor) -> dict[str, Tensor]:
    """Hands as a shard has them, about (N, 3) origins."""
    return {
        "global_orient": matrix_to_axis_angle(hand.global_orient),
        "hand_pose": matrix_to_axis_angle(hand.hand_pose).flatten(1),
        "transl": hand.transl - origin,
    }


def _parameters(path: Path, name: str, shape: tuple[int, ...], n: int) -> Tensor:
    """(n, *shape) of an array whose rows may have a further axis of one."""
    values = np.concatenate(list(npz_rows(path, name, _ROWS)))
    if len(values) != n or values[0].size != np.prod(shape) or not np.isfinite(values).all():
        raise UserError(f"{path}: {name} is of shape {values.shape}, or not finite; expected {(n, *shape)}.")
    return torch.tensor(values, dtype=torch.float32).reshape(n, *shape)
