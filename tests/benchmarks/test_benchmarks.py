import json
import subprocess
import sys
import time
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from grabnet.benchmarks.physics import CONFIG
from grabnet.benchmarks.run import SUITES, Benchmark
from grabnet.benchmarks.timing import Case, measure
from grabnet.cli import CONFIGS
from grabnet.errors import UserError

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


def test_medians_and_ratios_tell_what_was_slept():
    cases = [Case("slow", lambda: time.sleep(0.03)), Case("fast", lambda: time.sleep(0.01), ("slow",))]
    slow, fast = measure(cases, runs=5)
    assert slow.lower <= slow.median <= slow.upper
    assert 0.03 <= slow.median < 0.06
    assert 0.01 <= fast.median < 0.03
    assert 1 / 4 < fast.ratios["slow"] < 1 / 1.5
    assert not slow.ratios
    assert slow.runs == 5


def test_ratios_are_per_frame_where_frames_are_counted():
    one, ten = (
        Case("one", lambda: time.sleep(0.02), frames=1),
        Case("ten", lambda: time.sleep(0.02), ("one",), frames=10),
    )
    slow, fast = measure([one, ten], runs=3)
    assert fast.ratios["one"] == pytest.approx(0.1, rel=0.5)
    assert fast.frames_per_second == pytest.approx(10 * slow.frames_per_second, rel=0.5)


def test_the_first_run_does_not_count():
    delays = iter([0.5, 0, 0, 0])
    (timing,) = measure([Case("compiles first", lambda: time.sleep(next(delays)))], runs=3)
    assert timing.upper < 0.1


@pytest.mark.parametrize("suite", ["hand", "bps", "contact", "volume", "physics"])
def test_suites_write_their_figures(tmp_path, monkeypatch, suite):
    monkeypatch.setenv("GRABNET_CACHE", str(tmp_path))
    monkeypatch.setattr("grabnet.benchmarks.volume.SPACING", 0.004)  # the plain way takes seconds
    physics = OmegaConf.load(CONFIG)
    physics.shake.steps, physics.decomposition.resolution, physics.decomposition.iterations = 20, 100, 3
    OmegaConf.save(physics, tmp_path / "physics.yaml")
    monkeypatch.setattr("grabnet.benchmarks.physics.CONFIG", tmp_path / "physics.yaml")
    Benchmark(**(SETTINGS | {"suite": suite, "output": str(tmp_path / "bench.json")})).run()
    report = json.loads((tmp_path / "bench.json").read_text())
    assert {"timings", "settings", "threads", "versions", "made"} <= report.keys()
    for timing in report["timings"]:
        assert timing["median"] > 0
        assert all(ratio > 0 for ratio in timing["ratios"].values())
    assert any(timing["ratios"] for timing in report["timings"])


@pytest.mark.parametrize(("suite", "batch"), [("train", 256), ("hand", 32)])
def test_the_batch_is_the_suites_unless_told(suite, batch):
    standard = OmegaConf.load(CONFIGS / "benchmark.yaml").batch
    assert Benchmark(**(SETTINGS | {"suite": suite, "batch": standard})).batch == batch


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"suite": "sfd"}, f"no suite 'sfd'; choose from {', '.join(SUITES)}"),
        ({"runs": 1}, "runs=1 is too small; it must be at least 2"),
        ({"batch": 0}, "batch=0"),
        ({"device": "tpu"}, "device=tpu"),
    ],
)
def test_values_out_of_range_are_refused(change, sentence):
    with pytest.raises(UserError, match=sentence):
        Benchmark(**(SETTINGS | change))


def test_the_command_refuses_in_one_sentence():
    done = subprocess.run([sys.executable, SCRIPT, "suite=sfd"], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("error: There is no suite 'sfd'")
    assert done.stderr.count("\n") == 1
