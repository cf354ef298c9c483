"""From recordings to a data set of training frames: what `scripts/preprocess.py` does.

The data set's folder gets
    frames/                    the frames store, the same bytes whoever made it and however often he was stopped
    tools/object_meshes/…      the objects, so that training finds them
    card.json, card.md         what it is; waterfall.csv: what the filter took away
    agreement.json             with contact=recompute: how far our labels agree with the files'
    failures.json              recordings that could not be used, with the reason
    waterfall.png, contact.png pictures
    run.json                   when, where and how fast the last run was
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from torch import Tensor

from grabnet.body.hand import HandModel
from grabnet.data.batches import BatchAssembler
from grabnet.data.frames import finish_store, read_frames, read_header, shard_names, shard_path
from grabnet.data.objects import OBJECT_MESHES, ObjectSet
from grabnet.data.sequences import load_below
from grabnet.data.splits import MIRRORED, split_of
from grabnet.data.targets import contact_share
from grabnet.errors import UserError
from grabnet.files import existing, leftovers, replacing, sha256, write_json
from grabnet.geometry.mesh import Mesh, load_mesh, save_mesh
from grabnet.preprocess.backends import Outcome, by_dask, by_joblib, machine_cores
from grabnet.preprocess.card import Card
from grabnet.preprocess.filtering import FrameFilter
from grabnet.preprocess.grasp_track import mirror_image
from grabnet.preprocess.recordings import Recordings
from grabnet.preprocess.sequence_work import SequenceWork, peak_memory
from grabnet.provenance import provenance, versions

SOURCES, LABELS, BACKENDS = ("open", "grab"), ("stored", "recompute"), ("joblib", "dask")
# What is written beside the store.
_RECORDS = ("card.*", "waterfall.*", "contact.png", "agreement.json", "failures.json", "run.json")


@dataclass(frozen=True)
class Preprocessing:
    """What to make; the values of `configs/preprocess/preprocess.yaml`, which explains them.

    Raises:
        UserError: a value out of range.
    """

    data: str
    open: dict[str, str]
    grab: dict[str, str | None]
    models: dict[str, str | None]
    filter: FrameFilter
    val_objects: list[str]
    test_objects: list[str]
    output: str
    contact: str
    contact_distance: float
    pictures: bool
    cache_dir: str | None
    backend: str
    workers: int
    scheduler: str | None
    threads: int | None
    max_deaths: int

    def __post_init__(self):
        for name, options in {"data": SOURCES, "contact": LABELS, "backend": BACKENDS}.items():
            if (value := getattr(self, name)) not in options:
                raise UserError(f"{name} is '{value}'; it can be {' or '.join(options)}.")
        for name in ("workers", "threads", "max_deaths"):
            if (value := getattr(self, name)) is not None and value < 1:
                raise UserError(f"{name} is {value}; it must be at least 1.")
        if not self.contact_distance > 0:
            raise UserError(f"contact_distance is {self.contact_distance}; it must be a length in metres above 0.")
        if self.data == "grab" and None in (self.grab["root"], self.models["root"]):
            raise UserError("data=grab needs grab.root=<folder with grab/ and tools/> and models.root=<folder>.")
        if (self.backend == "dask") != (self.scheduler is not None):
            raise UserError("backend=dask and scheduler=tcp://… belong together: give both or neither.")

    @cached_property
    def recordings(self) -> Recordings:
        if self.data == "open":
            return Recordings(self.open["root"], None)
        return Recordings(self.grab["root"], self.models["root"])

    @property
    def root(self) -> Path:
        return Path(self.output).resolve()

    @property
    def store(self) -> Path:
        return self.root / "frames"

    @cached_property
    def hand(self) -> HandModel:
        return HandModel(self.recordings.hand("right"))

    def recipe(self) -> dict[str, Any]:
        """All that decides a shard besides its recording: settings, models, and this code."""
        sources = sorted(Path(__file__).parent.glob("*.py"))
        bodies = sorted({self.recordings.body(gender) for gender in ("female", "male")}) * (self.contact == "recompute")
        return {
            "filter": asdict(self.filter),
            "contact": self.contact,
            "contact_distance": self.contact_distance,
            "models": {path.name: sha256(path) for path in (self.recordings.hand("right"), *bodies)},
            "code": sha256(*sources),
        }

    def run(self) -> list[Outcome]:
        """Make the data set, or what is missing of it.

        Returns:
            the outcomes that are failures.

        Raises:
            UserError: no recordings, models or scheduler; a store of another recipe or of other files; hand templates
                that don't fit the model; a disk that takes no more.
        """
        names, start = self.recordings.names(), time.monotonic()
        with _alone_in(self.store):
            self._check_recipe()
            self._tidy()
            done = self._done(names)
            outcomes = list(self._work(names, done))
            failures = sorted((o for o in outcomes if o.failure), key=lambda o: o.name)
            write_json(self.root / "failures.json", {o.name: o.failure for o in failures})
            headers = {name: read_header(shard_path(self.store, name)) for name in shard_names(self.store)}
            if headers:
                self._finish(headers, failures)
            self._record(outcomes, headers, time.monotonic() - start)
        return failures

    def _check_recipe(self) -> None:
        """Write the recipe down, or make sure that it is what the store was begun with."""
        recipe, path = self.recipe(), self.store / "recipe.json"
        remedy = f"delete {self.store}, or choose another output="
        if not path.exists():
            if shard_names(self.store):
                raise UserError(f"{self.store} holds frames that were not made from recordings: {remedy}.")
            write_json(path, recipe)
            return
        begun, now = _flat(json.loads(path.read_text())), _flat(recipe)
        changed = [key for key in sorted(begun.keys() | now.keys()) if begun.get(key) != now.get(key)]
        if changed:
            key = changed[0]
            raise UserError(
                f"{self.store} was begun with {key}={begun.get(key)}, now it is {now.get(key)}: {remedy}, or go back."
            )

    def _tidy(self) -> None:
        """Remove what a killed run left half-written."""
        own = leftovers(self.root, *_RECORDS, str(OBJECT_MESHES / "*.*"))
        for path in (*own, *leftovers(self.store, "*.*", "shards/*/*.*")):
            path.unlink()

    def _done(self, names: list[str]) -> set[str]:
        """Recordings whose shards are there, made of the files as they are."""
        digests: dict[str, str] = {}
        shards = shard_names(self.store)
        known = {*names, *(name + MIRRORED for name in names)}
        for name in shards:
            path = shard_path(self.store, name)
            if name not in known:
                raise UserError(f"{path} is of a recording that {self.recordings.folder} does not hold: delete it.")
            for file, digest in read_header(path)["inputs"].items():
                now = self.recordings.folder / file
                if file not in digests:
                    digests[file] = sha256(existing(now, "File"))
                if digests[file] != digest:
                    raise UserError(
                        f"{path} was made when {now} was another file: delete the shard to have it made anew, or "
                        f"choose another output=."
                    )
        there = set(shards)
        wanted = ("", MIRRORED) if self.filter.mirror_left else ("",)
        return {name for name in names if all(name + suffix in there for suffix in wanted)}

    def _work(self, names: list[str], done: set[str]) -> Iterator[Outcome]:
        """Outcomes of what is not done, with a progress bar."""
        cores = 1 if self.backend == "dask" else machine_cores() // self.workers
        work = SequenceWork(
            self.recordings, self.filter, self.contact, self.contact_distance, self.store, self.threads or max(1, cores)
        )
        left = [name for name in names if name not in done]
        outcomes = (
            by_dask(work, left, self.scheduler)
            if self.backend == "dask"
            else by_joblib(work, left, self.workers, self.max_deaths)
        )
        columns = (TextColumn("Recordings"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Progress(*columns, TextColumn("left:"), TimeRemainingColumn(), TextColumn("{task.description}")) as bar:
            task = bar.add_task("", total=len(names), completed=len(done))
            for outcome in outcomes if left else ():
                bar.update(task, advance=1, description=outcome.name)
                if outcome.failure:
                    bar.console.print(f"{outcome.name} failed: {outcome.failure}", markup=False, style="red")
                yield outcome

    def _finish(self, headers: dict[str, dict[str, Any]], failures: list[Outcome]) -> None:
        """From shards to a data set."""
        v_template = self._templates(headers)
        objects = sorted({header["object"] for header in headers.values()})
        hashes = {name: self._place_object(name) for name in objects}
        contact = self._contact(headers, v_template)
        recipe = json.loads((self.store / "recipe.json").read_text())
        facts = {
            "source": "recordings",
            "recipe": recipe,
            "versions": versions(),
            "objects_sha256": hashes,
            "split": {"val": self.val_objects, "test": self.test_objects},
        }
        card = Card(headers, {name: self._split(name) for name in objects}, {o.name for o in failures}, facts)
        card.write(self.root)
        if self.pictures:
            from grabnet.preprocess.pictures import draw_contact, draw_waterfall

            draw_waterfall(card.waterfall, self.root / "waterfall.png")
            if contact is not None:
                draw_contact(self.hand, contact, self.root / "contact.png")
        finish_store(self.store, v_template, objects, facts, contact)

    def _split(self, name: str) -> str:
        return split_of(name, self.val_objects, self.test_objects)

    def _templates(self, headers: dict[str, dict[str, Any]]) -> dict[str, Tensor]:
        """(V, 3) rest right hand of each subject, by name."""
        paths: dict[str, str] = {}
        for name, header in headers.items():
            path = paths.setdefault(header["subject"], header["template"])
            if path != header["template"]:
                raise UserError(f"{name} has its hand from {header['template']}, others of its subject from {path}.")
        templates = {}
        for subject, path in sorted(paths.items()):
            mesh = load_below(self.recordings.folder, path)
            if len(mesh.vertices) != (n := len(self.hand.v_template)):
                raise UserError(
                    f"{self.recordings.folder / path} has {len(mesh.vertices)} vertices, the hand model {n}."
                )
            templates[subject] = torch.tensor((mirror_image(mesh) if subject.endswith(MIRRORED) else mesh).vertices)
        return templates

    def _place_object(self, name: str) -> str:
        """Put an object's mesh, or its mirror image, where training looks for it; its hash."""
        source = self.recordings.objects[name.removesuffix(MIRRORED)]
        target = self.root / OBJECT_MESHES / (f"{name}.ply" if name.endswith(MIRRORED) else source.name)
        if name.endswith(MIRRORED):
            save_mesh(target, mirror_image(load_mesh(source)))
        elif target != source:
            with replacing(target) as temporary:
                shutil.copyfile(source, temporary)
        mesh: Mesh = load_mesh(target)
        return mesh.sha256

    def _contact(self, headers: dict[str, dict[str, Any]], v_template: dict[str, Tensor]) -> Tensor | None:
        """(V,) share of training frames in which each hand vertex touches."""
        kept = [
            name
            for name, header in headers.items()
            if header["counts"]["fingers"]["frames"] and self._split(header["object"]) == "train"
        ]
        if not kept:
            return None
        objects = sorted({headers[name]["object"] for name in kept})
        object_set = ObjectSet.load(self.root / OBJECT_MESHES, objects, cache_dir=self.cache_dir)
        assembler = BatchAssembler(self.hand, torch.stack(list(v_template.values())), object_set)
        return contact_share(read_frames(self.store, list(v_template), objects, kept), assembler, self.contact_distance)

    def _record(self, outcomes: list[Outcome], headers: dict[str, dict[str, Any]], seconds: float) -> None:
        """Write down what differs from run to run."""
        peaks: dict[str, int] = {}
        for outcome in outcomes:
            if outcome.worker:
                peaks[outcome.worker] = max(outcome.peak_bytes, peaks.get(outcome.worker, 0))
        frames = sum(
            headers[o.name]["counts"]["waterfall"]["in all"] for o in outcomes if not o.failure and o.name in headers
        )
        facts = provenance(
            recordings=len(outcomes),
            frames=frames,
            seconds=round(seconds, 3),
            peak_mb_of_workers={worker: round(n / 1e6) for worker, n in sorted(peaks.items())},
            peak_mb_of_main=round(peak_memory() / 1e6),
            backend=self.backend,
            workers=self.workers,
        )
        write_json(self.root / "run.json", facts)


def preprocess(wanted: Preprocessing) -> int:
    """Run; the exit code: 0 all well, 1 some recordings failed."""
    failures = wanted.run()
    print(f"The data set is in {wanted.root}: {wanted.root / 'card.md'} tells what it is.")
    if failures:
        print(f"error: {len(failures)} recordings failed; why is in {wanted.root / 'failures.json'}.", file=sys.stderr)
    return 1 if failures else 0


@contextmanager
def _alone_in(store: Path) -> Iterator[None]:
    """Have the store's folder for this process alone.

    Raises:
        UserError: another process has it, or it cannot be made.
    """
    try:
        store.mkdir(parents=True, exist_ok=True)
        handle = os.open(store, os.O_RDONLY)
    except OSError as error:
        raise UserError(f"{store} cannot be used ({error.strerror}): choose another output=.") from None
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UserError(f"Another run is at work on {store}: wait for it, or choose another output=.") from None
        yield
    finally:
        os.close(handle)


def _flat(facts: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested dicts as one, its keys joined by dots."""
    flat = {}
    for key, value in facts.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return flat
