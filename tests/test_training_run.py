"""Training runs for real on the tiny data set: what they write, resuming after SIGKILL, learning by heart."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from grabnet.cli import compose
from grabnet.errors import UserError
from grabnet.models.checkpoints import read_checkpoint
from grabnet.models.weights import load_coarsenet, load_refinenet, read_provenance
from grabnet.training_run import train

ROOT = Path(__file__).parents[1]


def tiny_overrides(root: Path, run_dir: Path, cache_dir: Path, model: str = "coarsenet", *more: str) -> list[str]:
    return [
        f"model={model}",
        "data=frames",
        f"data.root={root}",
        f"data.cache_dir={cache_dir}",
        "data.val_objects=[can]",
        "data.test_objects=[ring]",
        "data.batch_size=32",
        "data.near_points=32",
        f"run_dir={run_dir}",
        "model.width=32",
        "model.n_hidden=16",
        "trainer.max_epochs=3",
        "callbacks.progress_bar=null",
        *(["model.bps.n_points=128"] if model == "coarsenet" else []),
        *more,
    ]


@pytest.mark.parametrize("model", ["coarsenet", "refinenet"])
def test_a_run_leaves_all_its_records(model, tiny_dataset, tmp_path, cache_dir, hand):
    metrics = train(compose("train", tiny_overrides(tiny_dataset, tmp_path, cache_dir, model)))
    assert {"config.yaml", "provenance.json", "metrics.json", "model.safetensors", "checkpoints", "logs"} <= {
        p.name for p in tmp_path.iterdir()
    }
    for split in ("train", "val", "test"):
        # The Euclidean distance lies between one and three times the mean over its coordinates.
        v2v, mae = metrics[f"test/{split}/v2v"], metrics[f"test/{split}/v2v_mae"]
        assert 0 < mae < v2v < 3 * mae
    record = read_provenance(tmp_path)
    assert record["seed"] == 0 and record["config"]["model"]["width"] == 32
    assert record["data"]["frames"] == {"train": 96, "val": 48, "test": 48}
    assert json.loads((tmp_path / "metrics.json").read_text()) == metrics
    network = load_coarsenet(tmp_path) if model == "coarsenet" else load_refinenet(tmp_path, hand)
    best = read_checkpoint(tmp_path / "checkpoints/best.ckpt")["state_dict"]
    for name, value in network.state_dict().items():
        torch.testing.assert_close(value, best[f"network.{name}"])


def test_both_networks_go_on_end_to_end_from_trained_ones(tiny_dataset, tmp_path, cache_dir, hand):
    for model in ("coarsenet", "refinenet"):
        train(compose("train", tiny_overrides(tiny_dataset, tmp_path / model, cache_dir, model)))
    overrides = [o for o in tiny_overrides(tiny_dataset, tmp_path / "both", cache_dir, "grabnet") if "model." not in o]
    start = [f"model.{name}={tmp_path / name}" for name in ("coarsenet", "refinenet")]
    train(compose("train", [*overrides, *start]))
    for name, load in (("coarsenet", load_coarsenet), ("refinenet", lambda path: load_refinenet(path, hand))):
        before, after = load(tmp_path / name), load(tmp_path / "both" / name)
        assert any(not torch.equal(a, b) for a, b in zip(before.parameters(), after.parameters(), strict=True))


def test_a_killed_run_goes_on_as_if_nothing_had_happened(tiny_dataset, tmp_path, cache_dir):
    unbroken, broken = tmp_path / "unbroken", tmp_path / "broken"
    overrides = ("trainer.max_epochs=25", "test=false")

    def command(run_dir: Path) -> list[str]:
        return [sys.executable, "train.py", *tiny_overrides(tiny_dataset, run_dir, cache_dir, "coarsenet", *overrides)]

    # Both in a process of their own: threads that an earlier test set would change the order of sums, so the last bit.
    subprocess.run(command(unbroken), cwd=ROOT, check=True, capture_output=True)
    process = subprocess.Popen(command(broken), cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    last = broken / "checkpoints/last.ckpt"
    while not last.exists() and process.poll() is None:
        time.sleep(0.02)
    time.sleep(0.5)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not (broken / "model.safetensors").exists(), "the run ended before it was killed: give it more epochs"
    killed_at = read_checkpoint(last)["global_step"]
    assert 0 < killed_at < 25 * 3
    subprocess.run(command(broken), cwd=ROOT, check=True, capture_output=True)
    for name, value in load_coarsenet(unbroken).state_dict().items():
        torch.testing.assert_close(load_coarsenet(broken).state_dict()[name], value, rtol=0, atol=0)


def test_frames_are_learned_by_heart(tiny_dataset, tmp_path, cache_dir):
    more = ("debug=overfit", "model.width=128", "model.n_hidden=64")
    overrides = [o for o in tiny_overrides(tiny_dataset, tmp_path, cache_dir) if "epochs" not in o and "batch" not in o]
    metrics = train(compose("train", [*overrides, *more]))
    assert metrics["test/train/v2v"] < 15  # 6.5 here; about 100 untrained


def test_a_damaged_checkpoint_is_named(tmp_path):
    path = tmp_path / "last.ckpt"
    torch.save({"state_dict": {}}, path)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(UserError, match=r"last\.ckpt cannot be read"):
        read_checkpoint(path)
