"""Synthetic captures of recordings, on disk: what `grabnet mosh synthesise` does.

The folder `out` gets
    captures/<subject>/<capture>.c3d    the markers of body and object, labelled <subject>:… and <object>:…
    objects.yaml                        where the objects' markers sit
    grab/…, tools/…                     the recordings that were captured: the truth
    truth/<subject>/<capture>.npz       where the markers sit on the body, and were, free of noise; see `write_truth`
    truth/<subject>/<capture>.json      how many markers are missing, and why
    recipe.json, run.json               settings, seeds and versions; how fast it was
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from grabnet.cli.checks import Concurrent, Name, Seed, in_range
from grabnet.cli.ends import say
from grabnet.cli.progress import steps
from grabnet.data.objects import OBJECT_MESHES
from grabnet.data.sequences import Sequence, load_below, read_sequence, write_sequence
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, load_mesh, save_mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.sight import Occluder
from grabnet.io.files import existing, replacing, sha256, write_json
from grabnet.io.litter import clear_litter
from grabnet.io.locks import alone_in
from grabnet.io.names import originals
from grabnet.io.provenance import provenance
from grabnet.io.recipes import claim
from grabnet.io.state import Finite, read_json
from grabnet.mosh.c3d import write_c3d
from grabnet.mosh.cameras import Rig, seen
from grabnet.mosh.layouts import Layout, ObjectLayout, read_layout, spread_markers, write_object_layouts
from grabnet.mosh.subjects import Subject
from grabnet.mosh.synthesis import Flaws, OnSkin, in_one_ring, object_markers, posed_vertices, spoilt, with_moving_face
from grabnet.preprocess.backends import by_joblib, machine_cores
from grabnet.preprocess.sequence_work import outcome_of

# Raise it when the same recording and settings would give another capture.
FORMAT = 1
_FACTS = {
    "object": str,
    "frames": Finite(1),
    "missing": Finite(0),
    "hidden": Finite(0),
    "cpu_seconds": Finite(0),
    "*": object,
}


@dataclass(frozen=True)
class SynthesisConfig:
    """What to capture; the values of `configs/mosh/synthesise.yaml`, which explains them.

    Raises:
        UserError: a value out of range.
    """

    root: str
    recordings: list[Name] | None
    out: str
    layout: str
    models: str | None
    face: bool
    flaws: Flaws
    occlusion: bool
    rig: Rig
    seed: Seed
    workers: Concurrent
    quiet: bool = False

    def __post_init__(self):
        in_range(self)
        if Path(self.out).resolve() == Path(self.root).resolve():
            raise UserError(f"out is root, {self.root}, whose recordings would be replaced: choose another out=")


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

    def __call__(self, name: str):
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

    def _sight(self, placed: Layout, on_object: ObjectLayout, rig: Rig):
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


def run(config: SynthesisConfig) -> int:
    """Make the captures, and say how they can be solved.

    Returns:
        the exit code: 0 all are made, 1 some failed.

    Raises:
        UserError: no such recordings; a layout for another body; a folder of another recipe.
    """
    root, out, began = existing(config.root, "Folder of recordings (root)"), Path(config.out), time.monotonic()
    names = _names(root, config.recordings)
    subject = Subject("", "neutral" if config.models is None else "male", None, config.models)
    layout = read_layout(config.layout, len(subject.body.v_template), subject.body.faces.numpy())
    rig = config.rig if config.occlusion else None
    with alone_in(out, "out"):
        claim(out / "recipe.json", _recipe(config), f"delete {out}, or choose another out=")
        clear_litter(out, "*/*/*.*", "tools/*/*/*.*")
        work = CaptureMaking(root, out, layout, config.models, config.face, config.flaws, rig, config.seed)
        left = [name for name in names if not capture_path(out, name).exists()]
        outcomes = []
        with steps("Making captures", len(names), len(names) - len(left)) as counted:
            workers = min(config.workers, machine_cores(), max(1, len(left)))
            for outcome in by_joblib(work, left, workers, max_deaths=3) if left else ():
                outcomes.append(outcome)
                counted.advance(about=outcome.name)
        failed = {outcome.name: outcome.failure for outcome in outcomes if outcome.failure}
        made = {name: _facts(out, name) for name in names if name not in failed}
        _write_objects(out, {fact["object"] for fact in made.values()})
        _summarise(config, made, time.monotonic() - began)
    for name, failure in sorted(failed.items()):
        say(f"{name}: {failure}")
    return 1 if failed else 0


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


def _names(root: Path, chosen: list[str] | None) -> list[str]:
    """Recordings below a root, all or those chosen by name."""
    folder = existing(root / "grab", "Folder of recordings")
    there = [f"{path.parent.name}/{path.stem}" for path in originals(folder.glob("*/*.npz"), folder)]
    if not there:
        raise UserError(f"{folder} holds no recordings: make some with grabnet build sequences.")
    if unknown := [name for name in chosen or () if name not in there]:
        raise UserError(f"{root} has no recording '{unknown[0]}'; it has {', '.join(there[:5])}, …")
    return there if chosen is None else list(dict.fromkeys(chosen))


def _recipe(config: SynthesisConfig) -> dict[str, Any]:
    """All that decides a capture besides its recording."""
    return {
        "format": FORMAT,
        "layout_sha256": sha256(existing(config.layout, "Layout")),
        "seed": config.seed,
        "face": config.face,
        "flaws": asdict(config.flaws),
        "rig": asdict(config.rig) if config.occlusion else {},
    }


def _facts(out: Path, name: str) -> dict[str, Any]:
    return read_json(out / "truth" / f"{name}.json", _FACTS, "delete it and its capture, which is made again then")


def _write_objects(out: Path, names: Iterable[str]) -> None:
    meshes = {name: load_mesh(out / OBJECT_MESHES / f"{name}.ply", weld=False, mend=False) for name in sorted(names)}
    write_object_layouts(out / "objects.yaml", [spread_markers(name, mesh) for name, mesh in meshes.items()])


def _summarise(config: SynthesisConfig, made: dict[str, dict[str, Any]], seconds: float) -> None:
    out = Path(config.out)
    frames, cpu = (sum(fact[key] for fact in made.values()) for key in ("frames", "cpu_seconds"))
    write_json(out / "run.json", provenance(captures=made, seconds=round(seconds, 3), config=asdict(config)))
    for name, fact in made.items():
        shares = f"{100 * fact['missing']:.1f} % of the markers missing, {100 * fact['hidden']:.1f} % hidden"
        print(f"{name}: {fact['frames']} frames, {shares} from the cameras")
    if not made:
        return
    print(f"Made {frames:,} frames at {frames / cpu:.0f} frames per second of one core. To solve them:")
    for person in dict.fromkeys(name.partition("/")[0] for name in made):
        template = next((out / "tools/subject_meshes").glob(f"*/{person}.ply"), None)
        shape = "" if template is None else f"gender={template.parent.name} subject={template} "
        print(
            f"  grabnet mosh capture={out / 'captures' / person} name={person} {shape}"
            f"objects={out / 'objects.yaml'} meshes={out / OBJECT_MESHES} out=solved"
        )
