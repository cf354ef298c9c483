import itertools
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from grabnet.benchmarks.physics import CONFIG
from grabnet.benchmarks.run import SUITES, BenchmarkConfig, run
from grabnet.benchmarks.timing import Case, measure
from grabnet.benchmarks.train import Step
from grabnet.cli.entry import CONFIGS
from grabnet.errors import UserError
from grabnet.geometry.sdf_grid import AtlasConfig
from tests.tiny import tiny_overrides

SCRIPT = Path(__file__).parents[2] / "scripts" / "benchmark.py"
SETTINGS = {
    "suite": "hand",
    "output": None,
    "runs": 2,
    "batch": 2,
    "threads": None,
    "device": "cpu",
    "seed": 0,
    "train": [],
}


class Clock:
    """Shows what was slept by it, however long that took."""

    now = 0.0

    def perf_counter(self) -> float:
        return self.now

    def sleeping(self, *seconds: float) -> Callable[[], None]:
        """What sleeps so long, turn by turn."""
        turns = itertools.cycle(seconds)

        def sleep() -> None:
            self.now += next(turns)

        return sleep


@pytest.fixture
def clock(monkeypatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr("grabnet.benchmarks.timing.time", clock)
    return clock


def test_medians_spread_and_ratios_tell_what_was_slept(clock):
    slow, fast = (
        Case("slow", clock.sleeping(9, 1, 2, 3, 4, 5)),
        Case("fast", clock.sleeping(9, 2, 4, 6, 8, 30), ("slow",)),
    )
    slow, fast = measure([slow, fast], runs=5)  # the first turn does not count
    assert (slow.lower, slow.median, slow.upper, slow.runs) == pytest.approx((2, 3, 4, 5))
    assert (fast.lower, fast.median, fast.upper, fast.runs) == pytest.approx((4, 6, 8, 5))
    assert fast.ratios["slow"] == pytest.approx(2)  # turn by turn, though the machine was five times as busy at last
    assert not slow.ratios and slow.frames_per_second is None


def test_a_case_of_fewer_runs_is_compared_with_the_same_turns(clock):
    short, long = Case("short", clock.sleeping(1, 1, 2, 100)), Case("long", clock.sleeping(9, 3, 6), ("short",), runs=2)
    short, long = measure([short, long], runs=3)
    assert (short.runs, long.runs, long.ratios["short"]) == pytest.approx((3, 2, 3))


def test_ratios_are_per_frame_where_frames_are_counted(clock):
    one = Case("one", clock.sleeping(0.02), frames=1)
    ten = Case("ten", clock.sleeping(0.04), ("one",), frames=10)
    slow, fast = measure([one, ten], runs=3)
    assert fast.ratios["one"] == pytest.approx(0.2)
    assert (slow.frames_per_second, fast.frames_per_second) == pytest.approx((50, 250))


# Less of what takes seconds.
GRID = AtlasConfig(fine_nodes=16**3, coarse_nodes=10**3)
SMALLER = {
    "volume.SPACING": 0.004,
    "sample.N_GRASPS": 4,
    "sdf.SMALL": GRID,
    "sdf.FULL": GRID,
    "preprocess.N_FRAMES": 120,
    "preprocess.N_RECORDINGS": 2,
    "preprocess.N_LOADED": 600,
    "preprocess.N_SHARDS": 6,
    "preprocess.N_PUBLISHED": 30,
    "preprocess.N_WRITTEN": 10,
}


@pytest.mark.parametrize("suite", sorted(SUITES))
def test_suites_write_their_figures(tmp_path, monkeypatch, cache_dir, tiny_dataset, suite):
    monkeypatch.setenv("GRABNET_CACHE", str(cache_dir))
    for name, value in SMALLER.items():
        monkeypatch.setattr(f"grabnet.benchmarks.{name}", value)
    tiny = [o for o in tiny_overrides(tiny_dataset, tmp_path, cache_dir) if o.startswith("data") and "batch" not in o]
    evaluate = OmegaConf.load(CONFIG)
    physics = evaluate.physics
    physics.shake.steps, physics.decomposition.resolution, physics.decomposition.iterations = 20, 100, 3
    OmegaConf.save(evaluate, tmp_path / "evaluate.yaml")
    monkeypatch.setattr("grabnet.benchmarks.physics.CONFIG", tmp_path / "evaluate.yaml")
    # What is compiled is traced, but not written in C++, which takes half a minute.
    with torch.compiler.set_stance("default", force_backend="aot_eager"):
        settings = SETTINGS | {"suite": suite, "train": tiny, "output": str(tmp_path / "bench.json")}
        assert run(BenchmarkConfig(**settings)) == 0
    report = json.loads((tmp_path / "bench.json").read_text())
    assert {"timings", "settings", "threads", "versions", "made"} <= report.keys()
    for timing in report["timings"]:
        assert timing["median"] > 0
        assert all(ratio > 0 for ratio in timing["ratios"].values())
    assert any(timing["ratios"] for timing in report["timings"])


@pytest.mark.parametrize("model", ["coarsenet", "refinenet"])
def test_the_plain_losses_are_those_of_training(model, tiny_dataset, cache_dir, tmp_path):
    """With all samples of the objects, compared by the nearest one, and the networks' noise the same."""
    published = ["data.object_points=512", "data.distance_to=samples"]
    published.append("model.loss.kl=0.3" if model == "coarsenet" else "model.loss.scale=0.7")
    overrides = tiny_overrides(tiny_dataset, tmp_path, cache_dir, model, *published)
    step = Step.make(BenchmarkConfig(**SETTINGS), overrides)
    torch.manual_seed(0)
    _, terms = step.module.reconstruct(step.module.prepared(step.batch))
    torch.manual_seed(0)
    plain = step.plain_terms()
    assert plain.keys() == terms.keys()
    for name, term in terms.items():  # what the true hand measures is kept in half precision
        assert plain[name].item() == pytest.approx(term.item(), rel=1e-3), name


@pytest.mark.parametrize(("suite", "batch"), [("train", 256), ("hand", 32)])
def test_the_batch_is_the_suites_unless_told(suite, batch):
    standard = OmegaConf.load(CONFIGS / "benchmark.yaml").batch
    assert BenchmarkConfig(**(SETTINGS | {"suite": suite, "batch": standard})).batch == batch


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"suite": "sfd"}, f"no suite 'sfd'; choose from {', '.join(SUITES)}"),
        ({"runs": 1}, "runs is 1; it must be at least 2"),
        ({"batch": 0}, "batch is 0; it must be at least 1"),
        ({"device": "tpu"}, "device is 'tpu'; it can be auto, cpu, cuda"),
    ],
)
def test_values_out_of_range_are_refused(change, sentence):
    with pytest.raises(UserError, match=sentence):
        BenchmarkConfig(**(SETTINGS | change))


def test_the_command_refuses_in_one_sentence():
    done = subprocess.run([sys.executable, SCRIPT, "suite=sfd"], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("error: There is no suite 'sfd'")
    assert done.stderr.count("\n") == 1
