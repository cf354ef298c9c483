"""Training in two processes, for real, against one process with the same batches."""

import csv
import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from grabnet.cli.entry import compose
from grabnet.errors import UserError
from grabnet.training.checkpoints import BEST, LAST, PREVIOUS
from grabnet.training.run import train
from tests.conftest import write_tiny_dataset
from tests.processes import start
from tests.tiny import tiny_overrides

# Steps in proportion to the gradient: Adam's would be the same had it not been divided by the number of processes.
# Small ones, since rounding turns the sign of an absolute difference here and there, and long steps make that grow.
NO_NOISE = (
    "model.dropout=0",
    "model.source.finger=0",
    "model.source.wrist=0",
    "model.source.transl=0",
    "data.rotate=false",
    "model.optimizer._target_=torch.optim.SGD",
    "model.optimizer.lr=1e-5",
)


@pytest.fixture(scope="module")
def odd_dataset(tmp_path_factory) -> Path:
    """22 frames for training, 11 for validation, 11 for the test."""
    return write_tiny_dataset(tmp_path_factory.mktemp("odd"), frames_per_sequence=11, subjects=1)


def overrides(root: Path, run_dir: Path, cache_dir: Path, model: str) -> list[str]:
    more = ("trainer.max_epochs=2", "data.batch_size=8", "callbacks.grasps.draw_every_n_epochs=2")
    return tiny_overrides(root, run_dir, cache_dir, model, *more, *(NO_NOISE if model == "refinenet" else ()))


@pytest.fixture(scope="module")
def two(odd_dataset, tmp_path_factory, cache_dir) -> dict[str, tuple[Path, str]]:
    """Run folder and what was printed, of each network's training in two processes; both at once, to save time."""
    runs = {}
    for model in ("coarsenet", "refinenet"):
        folder = tmp_path_factory.mktemp(model)
        output = folder.with_suffix(".txt")
        arguments = ["trainer=ddp_sim", *overrides(odd_dataset, folder, cache_dir, model)]
        runs[model] = folder, output, start(arguments, output)
    for _, output, process in runs.values():
        process.join(240)
        assert process.exitcode == 0, output.read_text()
    return {model: (folder, output.read_text()) for model, (folder, output, _) in runs.items()}


def logged(run_dir: Path, prefix: str = "") -> list[float]:
    """All that was logged, epoch by epoch, but for times, and counts of what lies at a threshold or just beyond."""
    with (run_dir / "logs/version_0/metrics.csv").open() as file:
        rows = [sorted(row.items()) for row in csv.DictReader(file)]
    wanted = [(k, v) for row in rows for k, v in row if v and k.startswith(prefix)]
    return [float(v) for k, v in wanted if not k.startswith("speed") and k != "val_grasps/contact_vertices"]


def test_two_processes_learn_what_one_does(two, odd_dataset, tmp_path, cache_dir):
    """RefineNet without its noise. CoarseNet cannot be compared: each process draws codes of its own."""
    train(compose("train", overrides(odd_dataset, tmp_path, cache_dir, "refinenet")))
    first, second = logged(tmp_path, "train/loss")
    assert second < 0.98 * first, "the steps are too small to tell whether they are the same"
    folder, _ = two["refinenet"]
    assert logged(folder) == pytest.approx(logged(tmp_path), rel=1e-4, abs=1e-6)
    metrics = [json.loads((run_dir / "metrics.json").read_text()) for run_dir in (tmp_path, folder)]
    assert metrics[0].keys() == metrics[1].keys()
    learned = load_file(folder / "model.safetensors")
    for name, weights in load_file(tmp_path / "model.safetensors").items():
        torch.testing.assert_close(learned[name], weights, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("model", ["coarsenet", "refinenet"])
def test_two_processes_write_one_run(two, model):
    folder, said = two[model]
    assert said.count("Weights, metrics and logs are in") == 1
    files = {"config.yaml", "provenance.json", "history.json", "metrics.json", "model.safetensors"}
    beside = {".hydra", ".lock", "train.log", "pictures"}
    assert {p.name for p in folder.iterdir()} - beside == {*files, "checkpoints", "logs"}
    assert [p.name for p in (folder / "logs").iterdir()] == ["version_0"]
    assert {p.name for p in (folder / "checkpoints").iterdir()} == {BEST, LAST, PREVIOUS}


def test_several_machines_need_a_launcher(odd_dataset, tmp_path, cache_dir):
    wanted = overrides(odd_dataset, tmp_path, cache_dir, "coarsenet")
    with pytest.raises(UserError, match=r"trainer.num_nodes=2 needs srun or torchrun"):
        train(compose("train", [*wanted, "trainer=ddp_sim", "trainer.num_nodes=2"]))


def test_a_missing_device_is_told_in_a_line(odd_dataset, tmp_path, cache_dir):
    wanted = overrides(odd_dataset, tmp_path, cache_dir, "coarsenet")
    with pytest.raises(UserError, match="trainer cannot be had as configured"):
        train(compose("train", [*wanted, "trainer.accelerator=tpu"]))
