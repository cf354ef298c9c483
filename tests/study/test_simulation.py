"""Synthetic raters, and what is found in their answers; power; the command lines of the study."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hydra.utils import instantiate

from grabnet.cli.entry import CONFIGS, compose
from grabnet.errors import UserError
from grabnet.study import power, simulation
from grabnet.study.key import CATCH
from grabnet.study.ordinal import ModelConfig, fit
from grabnet.study.raters import RaterModel, simulated_answers
from grabnet.study.scores import Ratings
from tests.cli.test_commands import leaves, typed
from tests.study.conftest import made_key

ROOT = Path(__file__).parents[2]
MODEL = RaterModel([-1.8, -0.9, -0.1, 1.5], reference=2.0, difference=-0.5, catch=-4.0, grasp=0.6, rater=0.8, own=0.3)
GIVEN = {"serve": ["export=a"], "analyse": ["export=a"]}


def made(name: str, *values: str):
    return instantiate(compose(f"study/{name}", [*GIVEN.get(name, []), *values]), _convert_="all")


def rated(model: RaterModel, key, raters: int, seed: int) -> Ratings:
    answers, _ = simulated_answers(key, model, raters, 0.0, np.random.default_rng(seed))
    return Ratings.of(answers, key.conditions, 5)


def test_raters_answer_as_the_model_says():
    key = made_key(objects=1, n=60, shown=None)
    answers, careless = simulated_answers(key, MODEL, 120, 0.0, np.random.default_rng(0))
    assert careless == set()
    for number, condition in enumerate([*key.conditions, CATCH]):
        given = [row.answer for row in answers.rows if key.videos[row.videos[0]].condition == condition]
        if condition != CATCH:
            assert np.mean(given) == pytest.approx(MODEL.mean_answer(number), abs=0.15)
    assert MODEL.expected(np.array([-50.0, 50.0])).tolist() == [1, 5]
    noisy = MODEL.answer(np.full(40_000, 0.7), np.random.default_rng(1)).mean()
    assert noisy == pytest.approx(float(MODEL.expected(np.array(0.7))), abs=0.03)


def test_the_ordinal_model_finds_what_was_planted():
    key = made_key(n=8, shown=None)
    model = replace(MODEL, difference=-1.5, grasp=0.5, rater=1.0)
    ratings = rated(model, key, 24, 4)
    found = fit(ratings, ModelConfig(warmup=80, draws=80, chains=1), 0)
    low, high = found.differences["generated", None].interval
    assert low < -1.5 < high < -0.5 and set(found.differences) == {("generated", o) for o in (None, *key.objects)}
    for name, value in (("rater", 1.0), ("grasp", 0.5)):
        low, high = found.deviations[name].interval
        assert low < value < high
    assert found.caution == ""
    with pytest.raises(UserError, match="two conditions"):
        fit(replace(ratings, conditions=["generated"]), ModelConfig(50, 50, 1), 0)


def test_errors_of_differences_are_those_of_many_studies():
    key = made_key(objects=2, n=6, shown=None)
    model = replace(MODEL, difference=-1.0)
    differences = []
    for seed in range(250):
        ratings = rated(model, key, 12, seed)
        differences.append(np.subtract(*(ratings.rating[ratings.condition == k].mean() for k in (1, 0))))
    error = power.components(model).error(raters=12, grasps=12, answers=12)
    assert np.std(differences) == pytest.approx(error, rel=0.13)
    planted = model.mean_answer(1) - model.mean_answer(0)
    assert np.mean(differences) == pytest.approx(planted, abs=3 * error / np.sqrt(250))


def test_power_grows_and_says_how_many_raters_are_needed(capsys, tmp_path):
    config = made("power", "raters=[10,40,160]", "grasps=[3,20]", f"output={tmp_path / 'power.json'}")
    assert power.run(config) == 0
    found = json.loads((tmp_path / "power.json").read_text())
    table = np.array(found["power"])
    assert (np.diff(table, axis=0) > 0).all() and (np.diff(table, axis=1) > 0).all()
    assert found["raters_needed"][0] is None and "no number of them" in capsys.readouterr().out
    n = found["raters_needed"][1]
    parts = power.components(power.planted(config.model, config.difference))
    reached = [power.power(-0.2, parts.error(r, 120, 30), 0.05) for r in (n - 1, n)]
    assert reached[0] < 0.8 <= reached[1]
    assert power.power(0.0, 1.0, 0.05) == pytest.approx(0.05)
    assert power.planted(MODEL, -0.3).mean_answer(1) == pytest.approx(MODEL.mean_answer(0) - 0.3)
    for wrong, sentence in [("difference=3", "no room"), ("difference=0", "difference is 0"), ("raters=[]", "raters"),
                            ("level=1", "level is 1"), ("model.thresholds=[1,0]", "must ascend")]:  # fmt: skip
        with pytest.raises(UserError, match=sentence):
            power.run(made("power", wrong))


def test_a_rehearsed_study_can_be_analysed(tmp_path):
    """By the real command lines: the filter finds the careless, the interval what was planted."""
    small = [
        "design.objects=2",
        "design.n=8",
        "design.shown=null",
        "design.lists=5",
        "draws=100",
        "repeats=4",
        "fits=0",
    ]
    study = tmp_path / "study"
    done = run("simulate", "raters=60", "careless=0.25", f"output={study}", "fits=0", *small)
    assert done.returncode == 0 and not done.stderr, done.stderr
    found = json.loads((study / "simulation.json").read_text())
    assert found["filter"]["recall"] > 0.9 and found["filter"]["precision"] > 0.5
    assert found["difference"]["studies"] == 4 and found["difference"]["in_interval"] >= 0.75
    planted = MODEL.mean_answer(1) - MODEL.mean_answer(0)
    assert found["difference"]["planted"] == pytest.approx(planted)
    done = run("analyse", f"export={study}", f"output={tmp_path / 'out'}", "model=null", "draws=50")
    assert done.returncode == 0 and not done.stderr, done.stdout + done.stderr
    with (tmp_path / "out/raters.csv").open() as file:
        reasons = Counter(row["counts"] for row in csv.DictReader(file))
    assert reasons["0"] + reasons["1"] == 60 and reasons["0"] >= 14


def test_synthetic_answers_replace_no_others(tmp_path):
    made_key().write(tmp_path / "study")
    (tmp_path / "study/private/secret").write_text("")
    (tmp_path / "answers.jsonl").write_text("")
    before = (tmp_path / "study/private/key.json").read_bytes()
    for values in (
        [f"output={tmp_path / 'study'}"],
        [f"export={tmp_path / 'study'}", f"output={tmp_path / 'study/private'}"],
        [f"export={tmp_path / 'study'}", f"output={tmp_path}"],
    ):
        with pytest.raises(UserError, match="holds a study or answers that no simulation wrote"):
            simulation.run(made("simulate", *values))
    assert (tmp_path / "study/private/key.json").read_bytes() == before


def test_a_stopped_simulation_is_run_again(tmp_path, monkeypatch):
    values = [f"output={tmp_path}", "raters=4", "design.objects=1", "design.n=2", "repeats=2", "fits=0", "draws=10"]
    with monkeypatch.context() as patch:
        patch.setattr(simulation, "_summary", interrupt)
        with pytest.raises(KeyboardInterrupt):
            simulation.run(made("simulate", *values))
    assert list(tmp_path.rglob("answers.jsonl"))
    assert simulation.run(made("simulate", *values)) == 0
    assert json.loads((tmp_path / "simulation.json").read_text())["studies"] == 2


def interrupt(*_):
    raise KeyboardInterrupt


def run(*arguments: str) -> subprocess.CompletedProcess:
    command = [sys.executable, str(ROOT / "scripts/study.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)})


@pytest.mark.parametrize("name", ["export", "serve", "analyse", "simulate", "power"])
def test_every_value_can_be_given_on_the_command_line_and_says_what_it_is(name):
    text = (CONFIGS / f"study/{name}.yaml").read_text()
    standard = compose(f"study/{name}", GIVEN.get(name, []))
    texts = ("text.", "design.", "model.", "filter.", "chains.")
    for key, value in leaves(standard):
        leaf = key.rpartition(".")[2]
        lines = [line for line in text.splitlines() if line.strip().startswith(f"{leaf}:")]
        assert lines, key
        if not key.startswith(texts) and leaf not in ("_target_",):
            assert any("#" in line for line in lines) or "null" in typed(value), key
    given = [f"{key}={typed(value)}" for key, value in leaves(standard) if not key.startswith("text.")]
    assert compose(f"study/{name}", [*GIVEN.get(name, []), *given]) == standard


def test_commands_are_named():
    done = run("analyze")
    assert done.returncode == 2 and done.stderr == "error: There is no command 'study analyze'; did you mean analyse?\n"
