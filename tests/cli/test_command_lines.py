"""Every value of every command's config on one real command line, which is then run to its end."""

from __future__ import annotations

import importlib
import json
import logging
import sys
from pathlib import Path

import pytest
import torch
import trimesh

from grabnet.body.hand import OPEN_HANDS
from grabnet.cli import progress
from grabnet.cli.entry import compose
from grabnet.commands import COMMANDS
from grabnet.data.sequences import read_sequence
from grabnet.models.weights import save_network
from grabnet.study.key import StudyKey
from grabnet.visual.pictures import can_render
from tests.cli.test_commands import CONFIG, leaves, typed
from tests.mosh.conftest import Actor, write_csv
from tests.mosh.recorded import record
from tests.preprocess.tiny_grab import overrides, write_grab
from tests.tiny import tiny_overrides


@pytest.fixture(scope="module")
def runs(grabber, tmp_path_factory) -> Path:
    runs = tmp_path_factory.mktemp("runs")
    save_network(runs / "coarse" / "model.safetensors", grabber.generator.coarsenet, {})
    save_network(runs / "fine" / "model.safetensors", grabber.generator.refinenet, {})
    return runs


@pytest.fixture
def call(monkeypatch, capfd):
    """Run a command on a command line that has every value of its config, none left to its default.

    Returns its exit code, and what it wrote to stdout and stderr.
    """
    threads, level = torch.get_num_threads(), logging.root.level
    monkeypatch.setattr(logging.root, "handlers", list(logging.root.handlers))  # Hydra sets others up
    monkeypatch.setattr(progress, "_FIRST", 1e-3)
    monkeypatch.setattr(progress, "_EVERY", 1e-3)

    def call(command: str, *few: str) -> tuple[int, str, str]:
        values = [f"{key}={typed(value)}" for key, value in leaves(compose(CONFIG[command], few))]
        groups = [given for given in few if given.partition("=")[0] not in {v.partition("=")[0] for v in values}]
        monkeypatch.setattr(sys, "argv", [*command.split(), *groups, *values])
        capfd.readouterr()
        code = importlib.import_module(COMMANDS[command.split()[0]][0]).main()
        return code, *capfd.readouterr()

    yield call
    torch.set_num_threads(threads)
    logging.root.setLevel(level)


def test_sample(call, runs, cache_dir, tmp_path):
    """A hand model by its file, too, and a network each from two places, as for networks trained with MANO."""
    ball = tmp_path / "a ball (1).ply"
    trimesh.creation.icosphere(2, 0.04).export(ball)
    few = ["n=2", f"mesh='{ball}'", f"output={tmp_path / 'out'}", "batch_size=4", "sheet=1", f"cache_dir={cache_dir}"]
    networks = [f"hand_model={OPEN_HANDS / 'MANO_RIGHT.npz'}", f"model=[{runs / 'coarse'},{runs / 'fine'}]"]
    code, out, err = call("sample", *few, *networks, "betas=[0.5,-1]", "up=x", "format=[glb,ply,npz]", "quiet=false")
    assert code == 0 and "2 grasps" in out
    assert {"Sampling meshes: 0 of 1", "Annotating contact: 0 of 2"} <= set(err.splitlines())
    record = json.loads((tmp_path / "out" / ball.stem / "grasps.json").read_text())
    assert record["config"]["betas"] == [0.5, -1] and len(record["grasps"]) == 2


def test_evaluate(call, runs, tiny_dataset, cache_dir, tmp_path):
    data = ["data=frames", f"data.root={tiny_dataset}", "data.split.val=[ring]", "data.split.test=[can]"]
    few = ["n=2", "halo_samples=2", "draws=20", "pictures=0", "processes=1", "simulated=1", "data.object_points=64"]
    places = ["models=[newest]", f"runs={runs}", f"cache_dir={tmp_path}", f"data.cache_dir={cache_dir}"]
    code, out, err = call("evaluate", *data, *few, *places, f"output={tmp_path / 'out'}", "quiet=false")
    assert code == 0 and "report.html" in out
    shown = {line.partition(":")[0] for line in err.splitlines()}
    cut, drawn = "Cutting objects into convex pieces", "Drawing grasps from CoarseNet + RefineNet"
    assert {cut, drawn, "Measuring grasps", "Reconstruction (train)"} <= shown


def test_study(call, runs, tiny_dataset, cache_dir, tmp_path):
    """From networks to a report; `serve`, which only ends when it is stopped, has tests of its own."""
    if (reason := can_render()) is not None:
        pytest.skip(reason)
    data = ["data=frames", f"data.root={tiny_dataset}", "data.split.val=[ring]", "data.split.test=[can]"]
    caches = [f"cache_dir={tmp_path}", f"data.cache_dir={cache_dir}"]
    evaluation = ",".join(f"'{v}'" for v in [*data, *caches, "optimise=2", "candidates=2"])
    few = ["n=2", "catches=2", "shown=null", "catches_shown=2", "lists=2", "processes=1", "film.size=64", "film.fps=4"]
    export = tmp_path / "study"
    places = ["models=[newest]", f"runs={runs}", f"evaluation=[{evaluation}]", f"output={export}"]
    code, out, err = call("study export", *few, *places, "quiet=false")
    assert code == 0 and "8 videos, 8 of them new" in out and "Filming grasps: 0 of 8" in err
    # Of a model only its last row is shown: what it gives as a whole, optimised.
    assert StudyKey.read(export).conditions == ["Ground truth", "CoarseNet + RefineNet, optimised, best of 2"]
    few = ["raters=6", "careless=0", "repeats=2", "fits=0", "draws=20"]
    code, out, err = call("study simulate", *few, f"export={export}", f"output={tmp_path / 'made'}", "quiet=false")
    assert code == 0 and "Simulating studies: 0 of 2" in err
    answers = [f"export={export}", f"answers=[{tmp_path / 'made' / 'answers.jsonl'}]", f"output={tmp_path / 'found'}"]
    code, out, err = call("study analyse", *answers, "draws=20", "model=null")
    assert code == 0 and "raters count" in out and (tmp_path / "found" / "report.html").exists()
    code, out, err = call("study power", f"output={tmp_path / 'power.json'}", "quiet=true")
    assert code == 0 and not err and (tmp_path / "power.json").exists()


def test_preprocess(call, cache_dir, tmp_path):
    root, models = tmp_path / "grab", tmp_path / "models"
    write_grab(root, models)
    given = overrides(root, models, tmp_path / "out", cache_dir, "pictures=false", "quiet=false")
    code, out, err = call("preprocess", *given)
    assert code == 0 and "card.md describes it" in out
    assert {"Reading recordings: 0 of 7"} <= set(err.splitlines())


def test_mosh(call, tmp_path):
    actor = Actor(frames=4)
    write_csv(tmp_path / "box (1)_lift.csv", actor.layout.labels, actor.markers)
    few = ["stage_one.iterations=1", "stage_one.annealing=[1.0]", "stage_one.frames=2", "stage_two.sweeps=1"]
    places = [f"capture='{tmp_path / 'box (1)_lift.csv'}'", f"out={tmp_path / 'out'}"]
    code, out, err = call("mosh", *few, *places, "workers=1", "pictures=false", "quiet=false")
    assert code == 0 and "4 frames, markers" in out
    assert {"Solving frames: 0 of 5"} <= set(err.splitlines())
    assert read_sequence(tmp_path / "out/grab/s1/box (1)_lift.npz").framerate == pytest.approx(24)


def test_mosh_of_recordings(call, tmp_path):
    """Captures of a recording, and the recording beside itself."""
    record(tmp_path / "recorded", {"s9/ball_lift_1": Actor(frames=2)})
    places = [f"root={tmp_path / 'recorded'}", f"out='{tmp_path / 'made (1)'}'", "workers=1", "quiet=false"]
    code, out, err = call("mosh synthesise", *places, "recordings=[s9/ball_lift_1]", "rig.heights=[1.0]")
    assert code == 0 and "s9/ball_lift_1: 2 frames" in out and "Making captures: 0 of 1" in err
    both = [f"truth='{tmp_path / 'made (1)'}'", f"solved={tmp_path / 'recorded'}", f"contact={tmp_path / 'recorded'}"]
    code, out, err = call("mosh judge", *both, f"output={tmp_path / 'a.json'}", "quiet=false")
    assert code == 0 and "Comparing recordings: 0 of 1" in err
    whole = json.loads((tmp_path / "a.json").read_text())["all"]
    assert whole["vertices"] == 0 and whole["object"] == 0 and whole["part_f1"] == whole["vertex_f1"] == 1


def test_mosh_layouts(call, tmp_path):
    code, out, _ = call("mosh place", "markers=plug_in_gait", f"output='{tmp_path / 'a (1).yaml'}'")
    assert code == 0 and "39 markers are in" in out and (tmp_path / "a (1).html").exists()


def test_benchmark(call, tmp_path):
    code, out, err = call("benchmark", "suite=hand", "runs=2", "batch=2", f"output={tmp_path / 'a.json'}", "quiet=true")
    assert code == 0 and "hand" in out and (tmp_path / "a.json").exists()
    assert not err


def test_train(call, tiny_dataset, cache_dir, tmp_path):
    few = tiny_overrides(tiny_dataset, tmp_path / "run", cache_dir, "coarsenet", "trainer.max_epochs=2")
    few.remove("callbacks.progress_bar=null")
    code, _, err = call("train", *few, "quiet=false")
    assert code == 0 and (tmp_path / "run" / "metrics.json").exists()
    assert "Training: 0 of 6 (epoch 1 of 2)" in err and "Testing: 0 of " in err
    assert any(line.startswith("Training: ") and "epoch 2 of 2, val/loss " in line for line in err.splitlines())
