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

import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from grabnet.data.frames import read_header, shard_names, shard_path
from grabnet.data.objects import OBJECT_MESHES
from grabnet.errors import UserError
from grabnet.io.files import leftovers, sha256, write_json
from grabnet.io.provenance import provenance
from grabnet.preprocess.backends import Outcome, by_dask, by_joblib, machine_cores
from grabnet.preprocess.filtering import FrameFilter
from grabnet.preprocess.finishing import Finishing
from grabnet.preprocess.recordings import Recordings
from grabnet.preprocess.resuming import alone_in, begin, shards_done
from grabnet.preprocess.sequence_work import SequenceWork, peak_memory

SOURCES, LABELS, BACKENDS = ("open", "grab"), ("stored", "recompute"), ("joblib", "dask")
# Modules here that decide no shard.
_AROUND = ("backends", "card", "finishing", "pictures", "pipeline", "resuming")
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

    def recipe(self) -> dict[str, Any]:
        """All that decides a shard besides its recording: settings, models, and the code that makes it."""
        sources = sorted(path for path in Path(__file__).parent.glob("*.py") if path.stem not in _AROUND)
        genders = ("female", "male") if self.contact == "recompute" else ()
        bodies = sorted({self.recordings.body(gender) for gender in genders})
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
        recipe = self.recipe()
        with alone_in(self.store):
            begin(self.store, recipe)
            for leftover in leftovers(self.root, *_RECORDS, str(OBJECT_MESHES / "*.*")):
                leftover.unlink()
            done = shards_done(self.store, self.recordings, names, self.filter.mirror_left)
            outcomes = list(self._work(names, done))
            failures = sorted((o for o in outcomes if o.failure), key=lambda o: o.name)
            write_json(self.root / "failures.json", {o.name: o.failure for o in failures})
            headers = {name: read_header(shard_path(self.store, name)) for name in shard_names(self.store)}
            if headers:
                finishing = Finishing(
                    self.root, self.recordings, self.val_objects, self.test_objects, self.contact_distance,
                    self.cache_dir, self.pictures,
                )  # fmt: skip
                finishing(headers, [o.name for o in failures], recipe)
            self._record(outcomes, headers, time.monotonic() - start)
        return failures

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

    def _record(self, outcomes: list[Outcome], headers: dict[str, dict[str, Any]], seconds: float) -> None:
        """Write down what differs from run to run."""
        peaks: dict[str, int] = {}
        for outcome in outcomes:
            if outcome.peak_bytes:
                peaks[outcome.worker] = max(outcome.peak_bytes, peaks.get(outcome.worker, 0))
        frames = sum(
            headers[o.name]["counts"]["waterfall"]["in all"] for o in outcomes if not o.failure and o.name in headers
        )
        facts = provenance(
            recordings=len(outcomes),
            frames=frames,
            seconds=round(seconds, 3),
            peak_mb_of_workers={worker: round(n / 1e6) for worker, n in sorted(peaks.items())},
            peak_mb_of_main=round(peak_memory() / 1e6) or None,
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
