"""From one recording to its synthetic capture: what a worker does."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from grabnet.data.objects import OBJECT_MESHES
from grabnet.data.sequences import Sequence, load_below, read_sequence, write_sequence
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, load_mesh, save_mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.sight import Occluder
from grabnet.io.files import existing, replacing, sha256, write_json
from grabnet.mosh.c3d import write_c3d
from grabnet.mosh.cameras import Rig, seen
from grabnet.mosh.layouts import Layout, ObjectLayout, spread_markers
from grabnet.mosh.subjects import Subject
from grabnet.mosh.synthesis import Flaws, OnSkin, in_one_ring, object_markers, posed_vertices, spoilt, with_moving_face
from grabnet.preprocess.backends import Outcome
from grabnet.preprocess.sequence_work import outcome_of


@dataclass(frozen=True)
class CaptureMaking:
    """Makes the capture of a recording when called with its name, in any process.

    Attributes:
        root: of the recordings. out: folder that is written to.
        layout: where the markers are meant to sit.
        models, face, flaws, seed: as configured.
        rig: cameras, which bodies and objects hide markers from; None: nothing is hidden.
    """

    root: Path
    out: Path
    layout: Layout
    models: str | None
    face: bool
    flaws: Flaws
    rig: Rig | None
    seed: int

    def __call__(self, name: str) -> Outcome:
        """Never raises for what is wrong with the one recording."""
        torch.set_num_threads(1)
        return outcome_of(name, self.out, lambda: self._make(name))

    def _make(self, name: str) -> None:
        began, own_seed = time.process_time(), seed_of(self.seed, name)
        sequence = read_sequence(self.root / "grab" / f"{name}.npz")
        sequence = with_moving_face(sequence, own_seed) if self.face else sequence
        stage = _Stage(self.root, sequence, self.models)
        on_object = spread_markers(sequence.obj_name, stage.mesh)
        # One subject's markers stay where they are from capture to capture.
        placed = in_one_ring(self.layout, stage.faces.numpy(), seed_of(self.seed, sequence.sbj_id))
        clean, hidden = stage.captured(placed, on_object, self.rig)
        found = spoilt(clean, sequence.framerate, self.flaws, own_seed, hidden)
        labels = [f"{sequence.sbj_id}:{label}" for label in placed.labels]
        labels += [f"{sequence.obj_name}:{label}" for label in on_object.labels]
        stage.copy_meshes(self.out)
        write_sequence(self.out / "grab" / f"{name}.npz", sequence)
        write_truth(self.out / "truth" / f"{name}.npz", labels, placed, clean, hidden)
        facts = {
            "recording_sha256": sha256(self.root / "grab" / f"{name}.npz"),
            "object": sequence.obj_name,
            "frames": len(sequence),
            "missing": round(float(np.isnan(found[..., 0]).mean()), 4),
            "hidden": round(float(hidden.mean()), 4),
            "seed": own_seed,
            "cpu_seconds": round(time.process_time() - began, 3),
        }
        write_json(self.out / "truth" / f"{name}.json", facts)
        write_c3d(capture_path(self.out, name), labels, found, sequence.framerate)


class _Stage:
    """A recording's body and object in motion."""

    def __init__(self, root: Path, sequence: Sequence, models: str | None):
        self._root, self._sequence = root, sequence
        self._body = _subject(sequence.gender, models).body
        self.faces = self._body.faces
        self._v_template = torch.tensor(load_below(root, sequence.body.vtemp, mend=False).vertices)
        if len(self._v_template) != len(self._body.v_template):
            raise UserError(
                f"{sequence.body.vtemp} has {len(self._v_template):,} vertices, the body model "
                f"{len(self._body.v_template):,}: they must be of one kind."
            )
        self.mesh = load_mesh(
            existing(root / OBJECT_MESHES / f"{sequence.obj_name}.ply", "Mesh of the object"), weld=False, mend=False
        )

    def captured(self, placed: Layout, on_object: ObjectLayout, rig: Rig | None) -> tuple[np.ndarray, np.ndarray]:
        """(T, M, 3) where the markers of body and object are, float64, and (T, M) which are hidden from the cameras."""
        on_body, objects = OnSkin(placed, self.faces), object_markers(self._sequence, on_object)
        sight = None if rig is None else self._sight(placed, on_object, rig)
        positions, hidden, first = [], [], 0
        for vertices in posed_vertices(self._sequence.body, self._body, self._v_template):
            now = slice(first, first + len(vertices))
            positions.append(np.concatenate([on_body(vertices), objects[now]], 1))
            hidden.append(np.zeros(positions[-1].shape[:2], bool) if sight is None else ~sight(vertices, now))
            first += len(vertices)
        return np.concatenate(positions), np.concatenate(hidden)

    def _sight(self, placed: Layout, on_object: ObjectLayout, rig: Rig) -> Callable[[Tensor, slice], np.ndarray]:
        """A function that says which markers (B, M) enough cameras see, of vertices (B, V, 3) and their frames."""
        moved, n = self._sequence.object, len(self._v_template)
        cameras = rig.places(self._sequence.body.transl.mean(0))
        out_of_skin = [replace(marker, distance=max(marker.distance, rig.marker)) for marker in placed.markers]
        start_on_body = OnSkin(replace(placed, markers=tuple(out_of_skin)), self.faces)
        start_on_object = _lifted(on_object, self.mesh, rig.marker)
        own = torch.tensor(self.mesh.vertices)
        occluder = Occluder(
            torch.cat([self._v_template, own]), np.concatenate([self.faces.numpy(), self.mesh.faces + n])
        )

        def seen_in(vertices: Tensor, now: slice) -> np.ndarray:
            starts = torch.cat(
                [torch.as_tensor(start_on_body(vertices)).float(), moved.to_world(start_on_object, now)], 1
            )
            both = torch.cat([vertices, moved.to_world(own, now)], 1)
            views = []
            for start, there in zip(starts, both, strict=True):
                occluder.move(there)
                views.append(seen(rig, cameras, start, occluder))
            return torch.stack(views).numpy()

        return seen_in

    def copy_meshes(self, out: Path) -> None:
        """Put the meshes that the recording names where the data set `out` keeps them."""
        tracks = self._sequence.body, self._sequence.rhand, self._sequence.lhand
        names = {track.vtemp for track in tracks} | {self._sequence.object.mesh, self._sequence.table.mesh}
        names.add(str(OBJECT_MESHES / f"{self._sequence.obj_name}.ply"))
        for name in names:
            if not (out / name).exists() and (self._root / name).exists():
                mesh = load_below(self._root, name, mend=False)
                (out / name).parent.mkdir(parents=True, exist_ok=True)
                save_mesh(out / name, mesh)


def capture_path(out: Path, name: str) -> Path:
    """Where the capture of a recording is written."""
    return out / "captures" / f"{name}.c3d"


def seed_of(seed: int, name: str) -> int:
    """A seed for what is random about `name`, whatever else there is."""
    return int.from_bytes(hashlib.sha256(f"{seed} {name}".encode()).digest()[:4])


def write_truth(path: Path, labels: list[str], placed: Layout, clean: np.ndarray, hidden: np.ndarray) -> None:
    """Write what is true of a capture, as `.npz`.

    Args:
        labels: (M,) of the markers, with prefixes; the body's come first.
        placed: where the body's sit: corners (B, 3) and weights (B, 3) of faces, and distance (B,) to the skin, m.
        clean: (T, M, 3) where all are, metres.
        hidden: (T, M) which the cameras don't see.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        np.savez_compressed(
            temporary,
            labels=np.array(labels),
            corners=np.array([marker.vertices for marker in placed.markers]),
            weights=np.array([marker.weights for marker in placed.markers]),
            distance=np.array([marker.distance for marker in placed.markers]),
            positions=clean.astype(np.float32),
            hidden=hidden,
        )


@lru_cache(maxsize=4)
def _subject(gender: str, models: str | None) -> Subject:
    return Subject("", gender, None, models)


def _lifted(layout: ObjectLayout, mesh: Mesh, distance: float) -> Tensor:
    """(M, 3) an object's markers, so far out of its surface."""
    points = torch.as_tensor(layout.positions).float()
    corners = torch.tensor(mesh.triangles)[MeshQuery(mesh).closest(points).face]
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return points + distance * torch.nn.functional.normalize(normals, dim=-1)
