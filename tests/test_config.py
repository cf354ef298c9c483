"""Config mistakes end in one sentence that names what exists."""

import subprocess
import sys
from pathlib import Path

import hydra
import pytest
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf

from grabnet.cli import CONFIGS, compose
from grabnet.config import check
from grabnet.errors import UserError
from train import main

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(
    ("argument", "sentence"),
    [
        ("model=corsenet", "There is no model 'corsenet'; model can be coarsenet, grabnet, refinenet"),
        ("model.latnt_dim=3", "Unknown key 'model.latnt_dim' in model; did you mean latent_dim?"),
        ("trainer.gradient_clip_val=1", "if its target takes it, write +trainer.gradient_clip_val=…"),
        ("model.latent_dim=abc", "model.latent_dim='abc' is of the wrong type: int is wanted."),
        ("data=frames", "The config value data.root must be given on the command line."),
        ("model.latent_dim=", "model.latent_dim='' is of the wrong type"),
    ],
)
def test_the_mistake_is_named(argument, sentence):
    with pytest.raises(UserError) as caught:
        compose("train", [argument])
    assert sentence in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("argument", ["model=corsenet", "seed"])
def test_the_command_says_it_in_a_line_and_leaves(argument):
    result = subprocess.run([sys.executable, "train.py", argument], cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 2
    assert result.stderr.startswith("error: ") and result.stderr.count("\n") == 1


@pytest.mark.parametrize("arguments", [["run_dir={}/run"], ["-m", "seed=0,1", "sweep_dir={}/run"]])
def test_a_folder_that_cannot_be_made_is_told(arguments, tmp_path, monkeypatch, capsys):
    (tmp_path / "file").touch()
    monkeypatch.setattr(sys, "argv", ["train.py", *(a.format(tmp_path / "file") for a in arguments)])
    with pytest.raises(SystemExit) as left:
        main()
    name = arguments[-1].partition("=")[0]
    sentence = f"{tmp_path}/file/run cannot be written to (Not a directory): choose another {name}."
    assert left.value.code == 2 and capsys.readouterr().err == f"error: {sentence}\n"


@pytest.mark.parametrize("group", ["experiment", "model", "debug", "trainer", "callbacks", "logger"])
def test_every_choice_composes(group):
    for file in (CONFIGS / group).glob("*.yaml"):
        assert compose("train", [f"{group}={file.stem}"])


def sample_target(size: int, rate: float = 0.1, name: str | None = None) -> None: ...


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"size": "3"}, r"node\.size='3' is of the wrong type: int"),
        ({"size": 3, "rate": True}, r"node\.rate=True is of the wrong type: float"),
        ({"size": True}, r"node\.size=True"),
        ({"size": 3, "sise": 3}, "node has no value sise; it takes size, rate, name"),
        ({"size": "???"}, r"node\.size must be given"),
    ],
)
def test_values_are_held_against_the_signature(values, sentence):
    node = {"_target_": f"{__name__}.sample_target", **values}
    with pytest.raises(UserError, match=sentence):
        check(OmegaConf.create({"node": node}))


def test_good_values_pass():
    node = {"_target_": f"{__name__}.sample_target", "size": 3, "rate": 1, "name": None}
    check(OmegaConf.create({"node": node, "list": [node]}))


def test_a_command_may_compose_the_config_of_another():
    with hydra.initialize_config_dir(str(CONFIGS), version_base="1.3"):
        running = GlobalHydra.instance().hydra
        assert compose("train", ["run_dir=x"]).seed == 0
        assert GlobalHydra.instance().hydra is running
