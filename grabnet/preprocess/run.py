"""From recordings to a data set of training frames: what `scripts/preprocess.py` does.

The data set's folder gets
    frames/                    the frames store, byte-identical whatever the backend or number of restarts
    tools/object_meshes/…      the objects, so that training finds them
    card.json, card.md         what it is; waterfall.csv: what the filter took away
    agreement.json             with data.contact=recompute: how far our labels agree with the files'
    failures.json              recordings that could not be used, with the reason
    waterfall.png, contact.png pictures
    run.json                   when, where and how fast the last run was
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from grabnet.cli.checks import Concurrent, Count, Distance, Name, in_range, one_of
from grabnet.cli.ends import note, say
from grabnet.cli.progress import steps
from grabnet.contact.rules import ContactRules
from grabnet.data.frames import FORMAT as STORE_FORMAT
from grabnet.data.frames import read_header, shard_names, shard_path, start_store
from grabnet.data.objects import OBJECT_MESHES
from grabnet.data.splits import MIRRORED_SUFFIX, Split
from grabnet.errors import UserError
from grabnet.io.files import write_json
from grabnet.io.litter import clear_litter
from grabnet.io.locks import alone_in
from grabnet.io.provenance import provenance
from grabnet.preprocess.backends import Outcome, by_dask, by_joblib, machine_cores
from grabnet.preprocess.filtering import FrameFilter
from grabnet.preprocess.finishing import HEADER, Finishing, other_hands
from grabnet.preprocess.recordings import RecordingSource
from grabnet.preprocess.resuming import shards_done
from grabnet.preprocess.sequence_work import FORMAT, SequenceWork, peak_memory

BACKENDS = ("joblib", "dask")
# What is written beside the store.
_RECORDS = ("card.*", "waterfall.*", "contact.png", "agreement.json", "failures.json", "run.json")


@dataclass(frozen=True)
class PreprocessConfig:
    """What to make; the values of `configs/preprocess/preprocess.yaml`, which explains them.

    Raises:
        UserError: a value out of range.
    """

    data: RecordingSource
    filter: FrameFilter
    split: Split
    output: Name
    contact_distance: Distance
    pictures: bool
    cache_dir: str | None
    backend: str
    workers: Concurrent
    dask_address: str | None
    threads: Concurrent | None
    max_deaths: Count
    contact: ContactRules = field(default_factory=ContactRules)  # for `data`, whose config refers to it
    quiet: bool = False  # for the command

    def __post_init__(self):
        one_of(self, backend=BACKENDS)
        in_range(self)
        if (self.backend == "dask") != (self.dask_address is not None):
            raise UserError("backend=dask and dask_address=tcp://… belong together: give both or neither.")

    @property
    def root(self) -> Path:
        return Path(self.output).resolve()

    @property
    def store(self) -> Path:
        return self.root / "frames"

    def recipe(self) -> dict[str, Any]:
        """All that decides a shard besides its recording."""
        return {
            "source": "recordings",
            "format": FORMAT,
            "store": STORE_FORMAT,
            "hand_sha256": self.data.hand().fingerprint,
            "filter": asdict(self.filter),
        } | self.data.recipe()


def run(config: PreprocessConfig) -> int:
    """Make the data set and say where it is.

    Returns:
        the exit code: 0 all recordings are in it, 1 some failed.

    Raises:
        UserError: as `preprocess`.
    """
    failures = preprocess(config)
    note(f"The data set is in {config.root}; {config.root / 'card.md'} describes it.")
    if failures:
        where = config.root / "failures.json"
        say(f"{len(failures)} recordings failed; why is in {where}.")
    return 1 if failures else 0


def preprocess(config: PreprocessConfig) -> list[Outcome]:
    """Make the data set, or what is missing of it.

    Returns:
        the outcomes that are failures.

    Raises:
        UserError: no recordings, models or dask; a store of another recipe or of other files; hand templates that
            don't fit the model; a disk that takes no more.
    """
    names, start = config.data.names(), time.monotonic()
    recipe = config.recipe()
    with alone_in(config.store, "output"):
        start_store(config.store, recipe, f"delete {config.store}, or choose another output=")
        clear_litter(config.root, *_RECORDS, str(OBJECT_MESHES / "*.*"))
        config.data.start()
        done = shards_done(config.store, config.data, names, config.filter.mirror_left)
        done = {name for name in done if config.data.is_complete(name)}
        outcomes = list(_work(config, names, done))
        headers = {name: read_header(shard_path(config.store, name), HEADER) for name in shard_names(config.store)}
        outcomes = _without_other_hands(config.store, outcomes, headers)
        failures = sorted((o for o in outcomes if o.failure), key=lambda o: o.name)
        write_json(config.root / "failures.json", {o.name: o.failure for o in failures})
        if headers:
            finishing = Finishing(
                config.root, config.data, config.split, config.contact_distance, config.cache_dir, config.pictures
            )
            finishing(headers, [o.name for o in failures], recipe)
        _record(config, outcomes, headers, time.monotonic() - start)
    return failures


def _work(config: PreprocessConfig, names: list[str], done: set[str]) -> Iterator[Outcome]:
    """Outcomes of what is not done."""
    cores = 1 if config.backend == "dask" else machine_cores() // config.workers
    work = SequenceWork(config.data, config.filter, config.store, config.threads or max(1, cores))
    left = [name for name in names if name not in done]
    outcomes = (
        by_dask(work, left, config.dask_address)
        if config.backend == "dask"
        else by_joblib(work, left, config.workers, config.max_deaths)
    )
    with steps("Reading recordings", len(names), len(done)) as counted:
        for outcome in outcomes if left else ():
            counted.advance(about=outcome.name)
            if outcome.failure:
                note(f"{outcome.name} failed: {outcome.failure}")
            yield outcome


def _without_other_hands(store: Path, outcomes: list[Outcome], headers: dict[str, dict[str, Any]]) -> list[Outcome]:
    """Outcomes where recordings of another's hand have failed; their shards and headers are removed."""
    others = {name.removesuffix(MIRRORED_SUFFIX): reason for name, reason in other_hands(headers).items()}
    for name in [name for name in headers if name.removesuffix(MIRRORED_SUFFIX) in others]:
        shard_path(store, name).unlink()
        del headers[name]
    done = [outcome for outcome in outcomes if outcome.name not in others]
    return done + [Outcome(name, reason) for name, reason in others.items()]


def _record(
    config: PreprocessConfig, outcomes: list[Outcome], headers: dict[str, dict[str, Any]], seconds: float
) -> None:
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
        peak_mb_of_main=round(peak_memory() / 1e6) or None,
        backend=config.backend,
        workers=config.workers,
    )
    write_json(config.root / "run.json", facts)
