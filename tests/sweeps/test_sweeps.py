"""Sweeps for real: failures outlived, killed ones resumed, a search, and jobs that a cluster interrupts."""

from __future__ import annotations

import csv
import signal
from pathlib import Path

import optuna
import pytest
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState
from PIL import Image

from grabnet.io.files import write_json
from grabnet.sweeps.runs import Run, folder_name
from grabnet.training.history import HISTORY, read_history
from hydra_plugins.grabnet_search import STUDY
from tests.faults import DiesPublishing
from tests.processes import finish
from tests.tiny import tiny_overrides

HOPELESS = "1e30"  # a learning rate with which nothing stays finite


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / "sweep.csv").open() as file:
        return list(csv.DictReader(file))


def test_names_tell_runs_apart_and_are_stable():
    values = {"model.latent_dim": "8"}
    name = folder_name(["seed=1", "sweep_dir=a", "model.latent_dim=8"], values)
    assert name.startswith("model.latent_dim=8-")
    assert name == folder_name(["model.latent_dim=8", "seed=1", "sweep_dir=b"], values)
    assert name != folder_name(["model.latent_dim=8", "seed=2"], values)
    assert "/" not in folder_name([], {"objects.dir": "/a/b"})


def test_a_sweep_outlives_a_failure_and_a_kill(tiny_dataset, tmp_path, cache_dir):
    sweep, output = tmp_path / "sweep", tmp_path / "output.txt"
    rates = f"model.optimizer.lr=0.001,{HOPELESS},0.002"
    arguments = ["-m", rates, f"sweep_dir={sweep}", *tiny_overrides(tiny_dataset, None, cache_dir)]
    killed = finish([*arguments, "test=false"], output, DiesPublishing("*lr=0.002*/checkpoints/last.ckpt", 2))
    assert killed == -signal.SIGKILL, output.read_text()
    done = next(sweep.glob("*lr=0.001*"))
    weights, last = done / "model.safetensors", next(sweep.glob("*lr=0.002*"))
    assert weights.exists() and not (last / "model.safetensors").exists()
    before = weights.stat().st_mtime_ns

    output.write_text("")
    assert finish([*arguments, "test=false"], output) == 1  # one failed
    told = output.read_text()
    assert "diverged: val/loss was never finite; lower model.optimizer.lr." in told and "Traceback" not in told
    assert f"Going on from {last}/checkpoints/last.previous.ckpt" in told
    assert weights.stat().st_mtime_ns == before
    assert [run["status"] for run in table(sweep)] == ["done", "failed", "done"]
    for run in table(sweep):
        epochs = read_history(sweep / run["folder"])
        if run["status"] == "done":
            assert float(run["val/loss"]) == min(e["val/loss"] for e in epochs) and len(epochs) == 3
            assert float(run["val/v2v"]) > 0 and float(run["seconds"]) > 0
        else:
            assert run["val/loss"] == "" and "diverged" in run["reason"]
    assert Image.open(sweep / "sweep.png").width > 600


def test_a_search_goes_on_where_it_was_killed(tiny_dataset, tmp_path, cache_dir):
    sweep, output = tmp_path / "search", tmp_path / "output.txt"
    tiny = tiny_overrides(tiny_dataset, None, cache_dir)
    more = ["callbacks.pruning.min_epochs=1", "callbacks.pruning.min_siblings=5", "test=false"]
    space = ["model.width=choice(16,32)", "data.batch_size=choice(32,64)", "hydra.sweeper.n_trials=5"]
    arguments = ["-m", "hparams_search=coarsenet", f"sweep_dir={sweep}", *tiny, *more, *space, "trainer.max_epochs=2"]
    better = [sweep / f"better_{k}" / HISTORY for k in range(5)]  # than any run, so that the first one is pruned
    for path in better:
        write_json(path, [{"epoch": 0, "val/v2v": 0.0}])
    damaged = sweep / "trial_001/checkpoints/last.ckpt"  # which the second fails by
    damaged.parent.mkdir(parents=True)
    damaged.write_bytes(b"")
    killed = finish(arguments, output, DiesPublishing(f"*/trial_002/{HISTORY}"))
    assert killed == -signal.SIGKILL, output.read_text()
    assert [run.status for run in (Run(sweep / f"trial_{i:03d}", (), {}) for i in range(3))] == [
        "pruned",
        "failed",
        "unfinished",
    ]
    for path in (*better, damaged):
        path.unlink()
    assert finish(arguments, output) == 0, output.read_text()
    runs = table(sweep)
    assert [run["folder"] for run in runs] == [f"trial_{i:03d}" for i in range(5)]
    assert [run["status"] for run in runs] == ["pruned", "done", "done", "done", "done"]
    storage = JournalStorage(JournalFileBackend(str(sweep / STUDY)))
    states = [trial.state for trial in optuna.load_study(study_name="search", storage=storage).trials]
    assert states == [TrialState.PRUNED, *[TrialState.COMPLETE] * 4]
    assert all(1e-4 <= float(run["model.optimizer.lr"]) <= 3e-3 for run in runs)
    assert {run["model.width"] for run in runs} <= {"16", "32"}
    assert len({run["model.optimizer.lr"] for run in runs}) == 5
    assert runs[0].keys().isdisjoint({"model.loss.kl", "model.latent_dim"})  # of which v2v likes an extreme
    for other in ("seed=1", "model.width=choice(16,64)"):
        assert finish([*arguments, other], output) == 2
        assert "give the same, or another sweep_dir" in output.read_text().splitlines()[-1]


@pytest.mark.parametrize(
    ("sweeper", "value", "sentence"),
    [
        ("search", "n_trials=0", "hydra.sweeper.n_trials=0 is not to be had; give a whole number from 1 up."),
        ("search", "n_jobs=0", "hydra.sweeper.n_jobs=0 is not to be had; give a whole number from 1 up."),
        ("search", "n_trials=abc", "hydra.sweeper.n_trials=abc is not to be had; give a whole number from 1 up."),
        ("grid", "params={seed:'range(1,1)'}", "There is nothing to run: a swept key has no values."),
    ],
)
def test_a_sweeper_that_could_not_run_is_told(sweeper, value, sentence, tmp_path):
    output = tmp_path / "output.txt"
    arguments = ["-m", f"hydra/sweeper={sweeper}", f"hydra.sweeper.{value}", f"sweep_dir={tmp_path}"]
    assert finish(arguments, output) == 2, output.read_text()
    assert output.read_text().startswith(f"error: {sentence}")


def test_an_interrupted_cluster_job_is_requeued_and_goes_on(tiny_dataset, tmp_path, cache_dir):
    sweep, output = tmp_path / "sweep", tmp_path / "output.txt"
    more = ("trainer.max_epochs=10", "callbacks.early_stopping=null", "test=false")
    interrupted = "+callbacks.interrupted._target_=tests.sweeps.interrupting.Interrupted"
    tiny = tiny_overrides(tiny_dataset, None, cache_dir, "coarsenet", *more, interrupted)
    arguments = ["-m", "seed=3", "hydra/launcher=submitit_local", f"sweep_dir={sweep}", *tiny]
    assert finish(arguments, output) == 0, output.read_text()
    (run,) = table(sweep)
    assert run["status"] == "done"
    assert [epoch["epoch"] for epoch in read_history(sweep / run["folder"])] == list(range(10))
    assert "Going on from" in (sweep / run["folder"] / "train.log").read_text()
