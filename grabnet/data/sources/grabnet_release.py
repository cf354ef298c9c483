"""The published GrabNet training data (ref. 2): parameters are read; stored vertices and BPS are compared with them."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from grabnet.body.hand import HandModel, HandParameters
from grabnet.cli.checks import Seed, Weight, in_range
from grabnet.data.objects import object_files
from grabnet.data.sources.base import FrameSource, HandFrames
from grabnet.data.sources.release_comparison import Comparison, ComparisonRecord, PosedFrames, compare, sample_rows
from grabnet.data.sources.release_geometry import StoredGeometry, fitted, stored_geometry
from grabnet.data.sources.release_names import FrameName, read_frame_names
from grabnet.data.splits import SPLITS
from grabnet.errors import UserError
from grabnet.geometry.bps import BPS
from grabnet.geometry.mesh import load_mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.io.files import existing, sha256
from grabnet.io.npz import npz_rows, read_npy

log = logging.getLogger(__name__)

# Raise it when the same release would give other frames or findings.
FORMAT = 2
# Rows of parameters read at a time.
_ROWS = 4096
# Points on an object's surface that are stored of a frame.
_POINTS = 2048
# Frames by which it is found out how the objects' rotations are to be read.
_FEW = 16
_HAND = {"global_orient_rhand_rotmat": (3, 3), "fpose_rhand_rotmat": (15, 3, 3), "trans_rhand": (3,)}
_OBJECT = {"root_orient_obj_rotmat": (3, 3), "trans_obj": (3,)}
# Metres between an object and the nearest vertex of a hand that grasps it, at most.
_REACH = 0.01
# Ends the names of the noisy hands' arrays.
_NOISY = "_f"


class GrabnetRelease(FrameSource):
    """The published data.

    An object's mesh stands in the release's world with the middle of its bounding box where the origin of its frame
    is (ref. 2). GRAB turns row vectors (ref. 1); where object points are stored, they decide whether the release does.

    Args:
        release: folder with the published `data` in it, or that folder itself.
        root: of the data set that is written; its store keeps what was compared, so that a killed call goes on.
        objects_dir: folder with a mesh for each object, such as GRAB's contact meshes.
        hand: the right hand that the data were made with, MANO's.
        noisy: keep the noisy hands, too, which RefineNet may start from (`StoredNoise`).
        check: number of frames of each split that are compared with stored vertices and BPS, or "all".
        tolerance: metres that the vertices of a compared frame may be off on average.
        bps_tolerance: the same of its BPS, whose distances are to points that lie apart on the object.
        seed: of the choice of these frames, which is spread over subjects and objects.

    Raises:
        UserError: here or when read: a value out of range; a file or array that is missing or misshapen; hands or
            objects that don't come out as stored.
    """

    def __init__(
        self,
        release: str,
        root: str,
        objects_dir: str,
        hand: HandModel,
        noisy: bool = True,
        check: int | str = 512,
        tolerance: Weight = 0.001,
        bps_tolerance: Weight = 0.004,
        seed: Seed = 0,
    ):
        if check != "all" and (type(check) is not int or check < 0):
            raise UserError(f"data.source.check is {check}; it must be a number of frames, 0 or more, or all.")
        self.release, self.root, self.objects_dir = Path(release), Path(root), objects_dir
        self.hand, self.noisy, self.check, self.seed = hand, noisy, check, seed
        self.tolerance, self.bps_tolerance = tolerance, bps_tolerance
        in_range(self, "data.source.")
        self._query = cache(lambda name: MeshQuery(load_mesh(self._meshes[name])))
        self._read_last: tuple[str, PosedFrames] | None = None  # one split takes up to 0.4 GB

    def recipe(self) -> dict[str, Any]:
        files = [self._piece(f"{split}/frame_names.npz") for split in SPLITS] + [self._piece("sbj_info.npy")]
        shown = {sequence.split("/")[1].split("_")[0] for sequence in self._rows}
        return {
            "source": "published GrabNet data",
            "format": FORMAT,
            "names_sha256": sha256(*files),
            "meshes_sha256": sha256(*(self._meshes[name] for name in sorted(shown))),
            "noisy": self.noisy,
            "check": self.check,
            "tolerance": self.tolerance,
            "bps_tolerance": self.bps_tolerance,
            "seed": self.seed,
        }

    def objects(self) -> Mapping[str, Path]:
        return self._meshes

    def subjects(self) -> Mapping[str, Tensor]:
        return self._subjects

    def sequences(self) -> Iterable[str]:
        """Names of all sequences, one split after the other, each compared first."""
        for split in SPLITS:
            self._compare(split)
            yield from (name for name, (of, _) in self._rows.items() if of == split)

    def read(self, sequence: str) -> HandFrames:
        split, rows = self._rows[sequence]
        names, posed = self._names[split], self._posed(split)
        first, rotations = names[rows[0]], posed.rotations[rows]
        return HandFrames(
            subject=first.subject,
            object=first.object,
            intent=first.action,
            frame=torch.tensor([names[row].frame for row in rows]),
            hand=posed.hand.select(rows),
            object_rotation=rotations,
            object_transl=posed.transl[rows] - (rotations @ posed.middle[rows].unsqueeze(2)).squeeze(2),
            noisy=None if posed.noisy is None else posed.noisy.select(rows),
        )

    def facts(self) -> dict[str, Any]:
        """How the release lies on disk, how it was read, and how far frames lie off what it stores."""
        return {
            "layout": {split: self._geometry[split].layout for split in SPLITS},
            "parameters_sha256": {split: sha256(self._parameters_file(split)) for split in SPLITS},
            "object_rotations": f"for {'row' if self._turns_rows else 'column'} vectors",
            "compared": self._record.millimetres(),
        }

    @cached_property
    def _folder(self) -> Path:
        folder = existing(self.release, "Published data (data.source.release)")
        return folder / "data" if (folder / "data").is_dir() else folder

    def _piece(self, name: str) -> Path:
        """A file of the release."""
        path = self._folder / name
        if not path.is_file():
            raise UserError(
                f"{path} is missing: unpack the whole release (scripts/unpack_grab.py), and name the folder that holds "
                f"train, val, test and sbj_info.npy as data.source.release."
            )
        return path

    def _parameters_file(self, split: str) -> Path:
        return self._piece(f"{split}/grabnet_{split}.npz")

    @cached_property
    def _names(self) -> dict[str, list[FrameName]]:
        names = {split: read_frame_names(self._piece(f"{split}/frame_names.npz")) for split in SPLITS}
        shown = {(name.subject, name.object) for split in SPLITS for name in names[split]}
        for what, there, known, source in (
            ("subjects", {subject for subject, _ in shown}, self._subjects, self._folder / "sbj_info.npy"),
            ("objects", {name for _, name in shown}, self._meshes, f"objects.dir={self.objects_dir}"),
        ):
            if unknown := sorted(there - known.keys()):
                raise UserError(
                    f"{self._folder} shows {what} that {source} does not have: {', '.join(unknown)}; it has "
                    f"{', '.join(known) or 'none'}."
                )
        return names

    @cached_property
    def _meshes(self) -> dict[str, Path]:
        return object_files(self.objects_dir)

    @cached_property
    def _subjects(self) -> dict[str, Tensor]:
        return read_subjects(self._piece("sbj_info.npy"), len(self.hand.v_template))

    @cached_property
    def _rows(self) -> dict[str, tuple[str, list[int]]]:
        """Split and rows of each sequence, in the order of its frames; one split after the other."""
        found: dict[str, tuple[str, list[int]]] = {}
        for split, names in self._names.items():
            for row in sorted(range(len(names)), key=lambda row: names[row].frame):
                sequence = names[row].sequence
                if found.setdefault(sequence, (split, []))[0] != split:
                    raise UserError(
                        f"{self._folder}: {sequence} is in {found[sequence][0]} and in {split}: download it again."
                    )
                found[sequence][1].append(row)
        return found

    @cached_property
    def _basis(self) -> Tensor | None:
        path = self._folder / "bps.npz"
        return BPS.load(path).basis if path.is_file() else None

    @cached_property
    def _geometry(self) -> dict[str, StoredGeometry]:
        n_vertices = len(self.hand.v_template)
        shapes = {"verts_rhand": (n_vertices, 3), "verts_object": (_POINTS, 3)}
        if self.noisy:
            shapes["verts_rhand_f"] = (n_vertices, 3)
        if self._basis is not None:
            shapes["bps_object"] = (len(self._basis),)
        return {split: stored_geometry(self._parameters_file(split), self._names[split], shapes) for split in SPLITS}

    @cached_property
    def _comparison(self) -> Comparison:
        return Comparison(self.hand, self._subjects, self._query, self._basis)

    @cached_property
    def _record(self) -> ComparisonRecord:
        recipe = self.recipe() | {"hand_sha256": self.hand.fingerprint}
        return ComparisonRecord(self.root / "frames" / "compared.json", recipe)

    def _compare(self, split: str) -> None:
        """Compare the chosen frames of a split with what is stored of them, and say what was found."""
        geometry, names = self._geometry[split], self._names[split]
        n = len(names) if self.check == "all" else min(self.check, len(names))
        if self._record.frames(split) < n:
            tolerance = dict.fromkeys(geometry.shapes, self.tolerance) | {"bps_object": self.bps_tolerance}
            rows = self._sample(split, n)
            compare(self._comparison, self._posed(split), geometry, rows, tolerance, self._record, split)
        elif not n:
            log.warning("%s: %s, of which nothing is compared (data.source.check=0).", split, geometry.layout)
            return
        found = self._record.millimetres()[split]
        off = (f"{name} {o['mean_mm']:.4f} (at most {o['max_mm']:.4f})" for name, o in found["off"].items())
        log.info(
            "%s: %s. %s of %s frames compared, millimetres off: %s.",
            split, geometry.layout, f"{n:,}", f"{len(names):,}", ", ".join(off),
        )  # fmt: skip
        if (apart := found["off"]["hand_to_object"]["mean_mm"]) > 1e3 * _REACH:
            raise UserError(
                f"{self._folder / split}: hands posed from its parameters are {apart:.1f} mm from their objects on "
                f"average, and grasps touch: pass the hand model and the meshes that the data were made with "
                f"(hand_model.path, objects.dir)."
            )

    def _sample(self, split: str, n: int) -> Tensor:
        """n rows of a split, ascending."""
        return sample_rows(self._names[split], n, [self.seed, SPLITS.index(split)]).sort().values

    @cached_property
    def _turns_rows(self) -> bool:
        """Whether the objects' rotations are for row vectors, as GRAB's are; stored object points decide if any are."""
        if self.check == 0:
            return True
        for split in SPLITS:
            if self._record.turns_rows is None and "verts_object" in self._geometry[split].shapes:
                rows, by_rows = self._sample(split, _FEW), self._by_rows(split)
                by_columns = by_rows._replace(rotations=by_rows.rotations.mT)
                geometry = self._geometry[split]
                off = [self._comparison.points_off(posed, geometry, rows) for posed in (by_rows, by_columns)]
                self._record.turns_rows = off[0] <= max(off[1], self.tolerance)
        return self._record.turns_rows is not False

    def _posed(self, split: str) -> PosedFrames:
        frames = self._by_rows(split)
        return frames if self._turns_rows else frames._replace(rotations=frames.rotations.mT)

    def _by_rows(self, split: str) -> PosedFrames:
        """All frames of a split, if the objects' rotations are for row vectors."""
        if self._read_last is None or self._read_last[0] != split:
            self._read_last = None
            path, names = self._parameters_file(split), self._names[split]

            def read(arrays: Mapping[str, tuple[int, ...]], ending: str = "") -> list[Tensor]:
                return [_parameters(path, name + ending, shape, len(names)) for name, shape in arrays.items()]

            hand = HandParameters(*read(_HAND))
            noisy = HandParameters(*read(_HAND, _NOISY)) if self.noisy else None
            rotations, transl = read(_OBJECT)
            middle = cache(lambda name: torch.as_tensor(load_mesh(self._meshes[name]).bounds).mean(0))
            middles = torch.stack([middle(name.object) for name in names])
            self._read_last = split, PosedFrames(names, hand, noisy, rotations.mT, middles, transl)
        return self._read_last[1]


def read_subjects(path: Path, n_vertices: int) -> dict[str, Tensor]:
    """(V, 3) right hand of each subject, from `sbj_info.npy`.

    Raises:
        UserError: no dict of subjects, or a hand that is missing, misshapen or not finite.
    """
    stored = read_npy(path)
    if not isinstance(stored, dict):
        raise UserError(f"{path} holds a {type(stored).__name__}, expected a dict of subjects: download it again.")
    hands = {}
    for name, facts in stored.items():
        v_template = np.asarray(facts.get("rh_vtemp") if isinstance(facts, dict) else None)
        is_numeric = v_template.dtype.kind in "fiu" and np.isfinite(v_template).all()
        if v_template.shape != (n_vertices, 3) or not is_numeric:
            raise UserError(
                f"{path}: rh_vtemp of {name} has shape {v_template.shape}, or no finite numbers; expected "
                f"({n_vertices}, 3): download it again."
            )
        hands[str(name)] = torch.as_tensor(v_template, dtype=torch.float32)
    return hands


def _parameters(path: Path, name: str, shape: tuple[int, ...], n: int) -> Tensor:
    """(n, *shape) float32 of an array, read in pieces."""
    values, start = np.empty((n, *shape), np.float32), 0
    for chunk in npz_rows(path, name, _ROWS):
        stop = start + len(chunk)
        if stop <= n:
            values[start:stop] = fitted(chunk, (len(chunk),), shape, str(path), name)
        start = stop
    if start != n:
        raise UserError(
            f"{path}: {name} has {start:,} rows, and {path.parent / 'frame_names.npz'} names {n:,} frames: download "
            f"both again."
        )
    return torch.as_tensor(values)
