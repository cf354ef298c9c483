"""Run a suite of benchmarks: the command `benchmark`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib import import_module

import torch
from rich.console import Console
from rich.table import Table

from grabnet.benchmarks.timing import Case, Timing, measure
from grabnet.cli.checks import Batch, Concurrent, Name, Seed, Several, in_range
from grabnet.cli.progress import steps
from grabnet.errors import UserError
from grabnet.generation.config import usable_device
from grabnet.io.files import write_json
from grabnet.io.provenance import provenance

# Each is a module here with `cases(settings) -> list[Case]`; imported only when it is run.
SUITES = {
    "sdf": "signed distance of hand vertices to objects, and building a grid",
    "bps": "basis point features of objects in many poses",
    "hand": "posing a batch of hands",
    "train": "one training step of each network",
    "sample": "grasps of a new mesh",
    "volume": "what hands and an object share, in voxels of 1 mm",
    "contact": "which vertices touch, of a whole body and an object",
    "preprocess": "from recordings to training frames, and loading these",
    "physics": "whether hands hold an object, simulated",
    "mosh": "body, hands and face from 99 markers",
}
# Frames at once where none are given: of training as many as it takes (ref. 7), of a capture two seconds.
BATCH = dict.fromkeys(SUITES, 32) | {"train": 256, "mosh": 240}


@dataclass(frozen=True)
class BenchmarkConfig:
    """What to time; the values of `configs/benchmark.yaml`, which explains them.

    Raises:
        UserError: an unknown suite or a value out of range.
    """

    suite: str
    output: Name | None
    runs: Several
    batch: Batch | None
    threads: Concurrent | None
    device: str
    seed: Seed
    train: list[str]
    quiet: bool = False  # for the command

    def __post_init__(self):
        if self.suite not in SUITES:
            raise UserError(f"There is no suite '{self.suite}'; choose from {', '.join(SUITES)}.")
        in_range(self)
        usable_device(self.device)
        if self.batch is None:
            object.__setattr__(self, "batch", BATCH[self.suite])


def run(config: BenchmarkConfig) -> int:
    """Time the suite, print a table and, where `config.output` names a file, write the figures to it.

    Returns:
        the exit code: 0.
    """
    torch.set_num_threads(config.threads or torch.get_num_threads())
    cases: Callable[[BenchmarkConfig], list[Case]] = import_module(f"grabnet.benchmarks.{config.suite}").cases
    with steps("Preparing", None):
        prepared = cases(config)
    timings = measure(prepared, config.runs)
    Console().print(_table(f"{config.suite}: {SUITES[config.suite]}", timings))
    if config.output:
        facts = provenance(settings=asdict(config), threads=torch.get_num_threads())
        write_json(config.output, {"timings": [asdict(timing) for timing in timings]} | facts)
    return 0


def _table(title: str, timings: Sequence[Timing]) -> Table:
    table = Table(title=title)
    for heading in ("case", "median ms", "quartiles ms", "frames/s", "compared"):
        table.add_column(heading, justify="left" if heading in ("case", "compared") else "right")
    for timing in timings:
        median, lower, upper = (f"{1e3 * s:.2f}" for s in (timing.median, timing.lower, timing.upper))
        compared = "\n".join(_in_words(ratio, name) for name, ratio in timing.ratios.items())
        rate = "" if timing.frames_per_second is None else f"{timing.frames_per_second:,.0f}"
        table.add_row(timing.name, median, f"{lower} to {upper}", rate, compared)
    return table


def _in_words(ratio: float, baseline: str) -> str:
    return f"{1 / ratio:.1f} times faster than {baseline}" if ratio < 1 else f"{ratio:.2f} times as long as {baseline}"
