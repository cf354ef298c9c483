"""Training runs for real on the tiny data set: what they write, resuming after SIGKILL, learning by heart."""

from __future__ import annotations

import json
import random
import signal
from dataclasses import replace
from importlib.metadata import version
from typing import Any, ClassVar

import lightning as L
import pytest
import torch
from hydra.errors import InstantiationException

from grabnet.cli.entry import compose
from grabnet.errors import UserError
from grabnet.geometry.bps import BPS
from grabnet.io.files import sha256
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.refinenet import RefineNet
from grabnet.models.trained import find_network
from grabnet.models.weights import load_network, read_provenance, save_network
from grabnet.training.checkpoints import newest_whole, read_checkpoint
from grabnet.training.history import read_history
from grabnet.training.run import train
from tests.faults import DiesAtStep, DiesPublishing, DiskIsFullAt
from tests.processes import finish
from tests.tiny import tiny_overrides


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
        assert 0 < metrics[f"test/{split}/published_v2v_mae"] < metrics[f"test/{split}/published_v2v"]
    record = read_provenance(tmp_path)
    assert record["seed"] == 0 and record["config"]["model"]["width"] == 32
    assert record["data"]["frames"] == {"train": 96, "val": 48, "test": 48}
    assert json.loads((tmp_path / "metrics.json").read_text()) == metrics
    network = load_network(tmp_path, hand)
    best = read_checkpoint(tmp_path / "checkpoints/best.ckpt")["state_dict"]
    for name, value in network.state_dict().items():
        torch.testing.assert_close(value, best[f"network.{name}"])


@pytest.mark.parametrize("experiment", ["paper", "surface_rotated"])
@pytest.mark.parametrize("model", ["coarsenet", "refinenet"])
def test_the_papers_experiment_and_ours_train(model, experiment, tiny_dataset, tmp_path, cache_dir):
    overrides = tiny_overrides(tiny_dataset, tmp_path, cache_dir, model, f"experiment={experiment}")
    metrics = train(compose("train", [*overrides, "data.min_steps=1", "callbacks.grasps=null"]))
    assert 0 < metrics["test/test/published_v2v_mae"] < metrics["test/test/published_v2v"]


def test_faster_ways_learn_nearly_the_same(tiny_dataset, tmp_path, cache_dir):
    found = {}
    for value in ("compile=false", "compile=true", "trainer.precision=bf16-mixed"):
        more = (value, "trainer.max_epochs=1", "test=false", "callbacks.grasps=null")
        torch._dynamo.reset()
        torch._dynamo.utils.counters.clear()
        # Traced with its gradient, but not written in C++, which takes minutes.
        with torch.compiler.set_stance("default", force_backend="aot_eager"):
            metrics = train(
                compose(
                    "train",
                    tiny_overrides(tiny_dataset, tmp_path / value.partition("=")[2], cache_dir, "coarsenet", *more),
                )
            )
        found[value] = metrics["val/v2v"], torch._dynamo.utils.counters["aot_autograd"]["ok"]
    (plain, none), (compiled, graphs), (half, _) = found.values()
    assert none == 0 and graphs >= 4  # residual blocks
    assert compiled == pytest.approx(plain, rel=1e-4)
    assert half != plain and half == pytest.approx(plain, rel=0.02)


@pytest.mark.parametrize("model", ["refinenet", "grabnet"])
def test_half_precision_trains_what_refines_as_well(model, tiny_dataset, tmp_path, cache_dir, hand):
    torch.manual_seed(0)
    save_network(tmp_path / "coarse.safetensors", CoarseNet(BPS(64), width=32, n_hidden=16), {})
    save_network(tmp_path / "refine.safetensors", RefineNet(hand, width=32, n_hidden=16), {})
    start = [f"model.{name}net={tmp_path / name}.safetensors" for name in ("coarse", "refine")]
    found = []
    for precision in ("32-true", "bf16-mixed"):
        more = (f"trainer.precision={precision}", "trainer.max_epochs=1", "test=false", "callbacks.grasps=null")
        overrides = tiny_overrides(tiny_dataset, tmp_path / precision, cache_dir, model, *more)
        if model == "grabnet":
            overrides = [o for o in overrides if not o.startswith("model.")] + start
        found.append(train(compose("train", overrides))["val/v2v"])
    # How far bf16's three digits lead three steps apart differs from processor to processor.
    assert found[0] != found[1] == pytest.approx(found[0], rel=0.05)


class Denormals(L.Callback):
    """Notes what a product too small for a normal number is in each step of a training."""

    products: ClassVar[list[float]] = []

    def on_train_batch_start(self, *_: Any) -> None:
        self.products.append(float(torch.tensor(1e-20) * torch.tensor(1e-19)))


def test_weights_that_decay_to_nothing_do_not_slow_a_training_down(tiny_dataset, tmp_path, cache_dir):
    more = ("trainer.max_epochs=1", "test=false", f"+callbacks.probe._target_={__name__}.Denormals")
    train(compose("train", tiny_overrides(tiny_dataset, tmp_path, cache_dir, "coarsenet", *more)))
    assert Denormals.products == [0.0] * 3


def test_both_networks_go_on_end_to_end_from_trained_ones(tiny_dataset, tmp_path, cache_dir, hand):
    for model in ("coarsenet", "refinenet"):
        train(compose("train", tiny_overrides(tiny_dataset, tmp_path / model, cache_dir, model)))
    overrides = [o for o in tiny_overrides(tiny_dataset, tmp_path / "both", cache_dir, "grabnet") if "model." not in o]
    start = [f"model.{name}={tmp_path / name}" for name in ("coarsenet", "refinenet")]
    train(compose("train", [*overrides, *start]))
    record = read_provenance(tmp_path / "both/refinenet")["trained_from"]
    for kind, name in {"CoarseNet": "coarsenet", "RefineNet": "refinenet"}.items():
        file = tmp_path / name / "model.safetensors"
        assert record[kind] == {"file": str(file), "sha256": sha256(file)}
        assert find_network(kind, None, tmp_path) == file
    for name in ("coarsenet", "refinenet"):
        before, after = (load_network(folder / name, hand) for folder in (tmp_path, tmp_path / "both"))
        assert any(not torch.equal(a, b) for a, b in zip(before.parameters(), after.parameters(), strict=True))
    file = tmp_path / "coarsenet/model.safetensors"
    network = load_network(file, kind="CoarseNet")
    network.conventions = replace(network.conventions, hand="0" * 64)
    save_network(file, network, {})
    guesses = ["model=refinenet", "source=guesses_to_recorded", f"model.source.coarsenet={file}"]
    for more in (start, guesses):
        with pytest.raises(InstantiationException) as told:
            train(compose("train", [*overrides, *more, f"run_dir={tmp_path / 'other'}"]))
        assert "was trained with another hand" in str(told.value.__cause__)


def test_a_run_killed_again_and_again_ends_as_if_nothing_had_happened(tiny_dataset, tmp_path, cache_dir):
    unbroken, broken = tmp_path / "unbroken", tmp_path / "broken"
    # No epoch is good enough for this schedule: the rate falls after each, and must not miss one.
    schedule = ("model.scheduler.patience=0", "model.scheduler.factor=0.8", "+model.scheduler.threshold=0.9")
    more = ("trainer.max_epochs=14", "test=false", "callbacks.early_stopping=null", *schedule)
    arguments = [tiny_overrides(tiny_dataset, run_dir, cache_dir, "coarsenet", *more) for run_dir in (unbroken, broken)]
    output = tmp_path / "output.txt"
    assert finish(arguments[0], output) == 0, output.read_text()
    reached = []
    faults = [DiesAtStep(random.randint(4, 11)), DiesPublishing("*/last.ckpt", random.randint(2, 4))]
    for fault in (*faults, DiesAtStep(random.randint(4, 11))):
        assert finish(arguments[1], output, fault) == -signal.SIGKILL, output.read_text()
        reached.append(read_checkpoint(newest_whole(broken / "checkpoints"))["global_step"])
    assert 0 < reached[0] < reached[1] < reached[2] < 14 * 3
    assert finish(arguments[1], output) == 0, output.read_text()
    weights = load_network(broken, kind="CoarseNet").state_dict()
    for name, value in load_network(unbroken, kind="CoarseNet").state_dict().items():
        torch.testing.assert_close(weights[name], value, rtol=0, atol=0)
    assert [epoch["epoch"] for epoch in read_history(broken)] == list(range(14))


def test_a_run_that_had_stopped_early_is_over(tiny_dataset, tmp_path, cache_dir):
    """Also where it was killed between its last checkpoint and its metrics."""
    more = ("trainer.max_epochs=50", "callbacks.early_stopping.patience=1", "model.optimizer.lr=0.06", "test=false")
    overrides = tiny_overrides(tiny_dataset, tmp_path, cache_dir, "coarsenet", *more)
    metrics, epochs = train(compose("train", overrides)), read_history(tmp_path)
    assert len(epochs) < 50
    weights = load_network(tmp_path, kind="CoarseNet").state_dict()
    for name in ("metrics.json", "model.safetensors"):
        (tmp_path / name).unlink()
    assert train(compose("train", overrides)) == metrics
    assert read_history(tmp_path) == epochs
    for name, value in load_network(tmp_path, kind="CoarseNet").state_dict().items():
        assert torch.equal(weights[name], value), name


def test_a_run_goes_on_with_the_settings_it_began_with(tiny_dataset, tmp_path, cache_dir):
    def run(*more: str) -> None:
        train(compose("train", tiny_overrides(tiny_dataset, tmp_path, cache_dir, "coarsenet", "test=false", *more)))

    run("trainer.max_epochs=1")
    with pytest.raises(UserError, match=r"was started with model\.width=32, now it is 16: choose another run_dir"):
        run("model.width=16")
    with pytest.raises(UserError, match=r"was started with seed=0, now it is 1"):
        run("seed=1", "data.seed=0")
    run("trainer.max_epochs=2", "logger.csv.name=more")
    assert [epoch["epoch"] for epoch in read_history(tmp_path)] == [0, 1]
    (attempt,) = read_provenance(tmp_path)["earlier"]
    assert attempt["made"] <= read_provenance(tmp_path)["made"] and attempt["versions"]["torch"] == version("torch")
    (tmp_path / "provenance.json").write_text("{}")
    with pytest.raises(UserError, match=r"provenance\.json is damaged .*resume=false"):
        run("trainer.max_epochs=3")
    run("trainer.max_epochs=1", "model.width=16", "resume=false", "tags=[narrow,short]")
    assert load_network(tmp_path, kind="CoarseNet").pose.in_features == 16
    assert read_provenance(tmp_path)["tags"] == ["narrow", "short"]


def test_a_run_without_time_for_an_epoch_says_so(tiny_dataset, tmp_path, cache_dir):
    overrides = tiny_overrides(tiny_dataset, tmp_path, cache_dir, "coarsenet", "trainer.max_epochs=0", "test=false")
    with pytest.raises(UserError, match=r"before its first epoch did: raise trainer\.max_epochs or trainer\.max_time"):
        train(compose("train", overrides))


def test_validation_may_be_of_every_second_epoch(tiny_dataset, tmp_path, cache_dir):
    more = ("trainer.max_epochs=4", "+trainer.check_val_every_n_epoch=2", "test=false")
    metrics = train(compose("train", tiny_overrides(tiny_dataset, tmp_path, cache_dir, "coarsenet", *more)))
    assert metrics["epoch"] in (1, 3)
    assert "val/loss" not in read_history(tmp_path)[0]


def test_a_damaged_checkpoint_gives_way_to_the_one_before(tiny_dataset, tmp_path, cache_dir, caplog):
    overrides = tiny_overrides(tiny_dataset, tmp_path, cache_dir, "coarsenet", "test=false")
    train(compose("train", overrides))
    last, previous = tmp_path / "checkpoints/last.ckpt", tmp_path / "checkpoints/last.previous.ckpt"
    assert read_checkpoint(last)["epoch"] == 2 and read_checkpoint(previous)["epoch"] == 1
    last.write_bytes(last.read_bytes()[:-100])
    assert newest_whole(last.parent) == previous and last.exists()  # asking changes nothing
    train(compose("train", overrides))
    told = [r.message for r in caplog.records if r.name == "grabnet.training.checkpoints"]
    assert told == [f"{last} is damaged: going on from last.previous.ckpt, the one before."]
    assert read_checkpoint(last)["epoch"] == 2
    last.write_bytes(b"")
    previous.write_bytes(previous.read_bytes()[:1000])
    with pytest.raises(UserError, match=r"last\.ckpt and .*last\.previous\.ckpt cannot be read, .* delete "):
        train(compose("train", overrides))


def test_a_full_disk_ends_in_a_sentence_and_the_last_checkpoint_stays(tiny_dataset, tmp_path, cache_dir):
    output, run_dir = tmp_path / "output.txt", tmp_path / "run"

    def overrides(epochs: int) -> list[str]:
        more = ("test=false", f"trainer.max_epochs={epochs}")
        return tiny_overrides(tiny_dataset, run_dir, cache_dir, "coarsenet", *more)

    train(compose("train", overrides(1)))
    last = run_dir / "checkpoints/last.ckpt"
    whole = last.read_bytes()
    assert finish(overrides(3), output, DiskIsFullAt(len(whole) // 2)) == 2
    told = output.read_text().splitlines()[-1]
    sentence = "(File too large): make room, or choose another place. The same command goes on from"
    assert told.startswith(f"error: {last.parent}/") and told.endswith(f" cannot be used {sentence} {last}.")
    assert "Traceback" not in output.read_text()
    assert last.read_bytes() == whole
    assert {p.name for p in last.parent.iterdir()} == {"best.ckpt", "last.ckpt"}  # nothing half-written is left
    assert finish(overrides(3), output) == 0
    assert read_checkpoint(last)["epoch"] == 2


def test_a_disk_that_fills_up_at_the_end_ends_in_a_sentence(tiny_dataset, tmp_path, cache_dir):
    output, run_dir = tmp_path / "output.txt", tmp_path / "run"
    no_checkpoints = ("+trainer.enable_checkpointing=false", "callbacks.checkpoint=null", "callbacks.last=null")
    more = ("test=false", "trainer.max_epochs=1", *no_checkpoints)
    overrides = tiny_overrides(tiny_dataset, run_dir, cache_dir, "coarsenet", *more)
    train(compose("train", overrides))
    weights = run_dir / "model.safetensors"
    size = weights.stat().st_size
    weights.unlink()
    assert finish(overrides, output, DiskIsFullAt(size // 2)) == 2
    told = output.read_text()
    assert told.splitlines()[-1] == (
        f"error: {weights} cannot be used (File too large): make room, or choose another place. "
        "No checkpoint was written yet."
    )
    assert "Traceback" not in told and not weights.exists()


@pytest.mark.parametrize(
    ("model", "value", "sentence"),
    [
        ("coarsenet", "logger.csv=null", "The trainer cannot run as configured: Cannot use `LearningRateMonitor`"),
        ("coarsenet", "+model.optimizer.eps=-1", "model.optimizer or model.scheduler: Invalid epsilon value: -1"),
    ],
)
def test_a_run_that_cannot_begin_ends_in_a_sentence(model, value, sentence, tiny_dataset, tmp_path, cache_dir):
    output = tmp_path / "output.txt"
    assert finish(tiny_overrides(tiny_dataset, tmp_path / "run", cache_dir, model, value), output) == 2
    told = output.read_text()
    assert told.splitlines()[-1].startswith(f"error: {sentence}") and "Traceback" not in told


def test_frames_are_learned_by_heart(tiny_dataset, tmp_path, cache_dir):
    more = ("debug=overfit", "model.width=256", "model.n_hidden=128")
    overrides = [o for o in tiny_overrides(tiny_dataset, tmp_path, cache_dir) if "epochs" not in o and "batch" not in o]
    metrics = train(compose("train", [*overrides, *more]))
    assert metrics["test/train/v2v"] < 2  # mm; about 100 untrained


def test_a_damaged_checkpoint_is_named(tmp_path):
    path = tmp_path / "last.ckpt"
    torch.save({"state_dict": {}}, path)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(UserError, match=r"last\.ckpt cannot be read"):
        read_checkpoint(path)
