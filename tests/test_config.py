"""Config mistakes end in one sentence that names what exists."""

import subprocess
import sys
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from grabnet.config import check
from grabnet.errors import UserError

ROOT = Path(__file__).parents[1]


def train(*arguments: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "train.py", *arguments], cwd=ROOT, capture_output=True, text=True)


@pytest.mark.parametrize(
    ("argument", "sentence"),
    [
        ("model=corsenet", "There is no model 'corsenet'; model can be coarsenet, refinenet."),
        ("model.latnt_dim=3", "Unknown key 'model.latnt_dim' in model; did you mean latent_dim?"),
        ("model.latent_dim=abc", "model.latent_dim='abc' is of the wrong type: int is wanted."),
        ("data=frames", "The config value data.root must be given on the command line."),
        ("model.latent_dim=", "model.latent_dim='' is of the wrong type"),
        ("seed", "The argument 'seed' has no value"),
    ],
)
def test_train_says_what_is_wrong(argument, sentence):
    result = train(argument)
    assert result.returncode == 2
    assert sentence in result.stderr
    assert result.stderr.count("\n") == 1 and "Traceback" not in result.stderr


def test_every_experiment_and_model_composes(tmp_path):
    for group in ("experiment", "model", "debug"):
        for file in (ROOT / "configs" / group).glob("*.yaml"):
            result = train(f"{group}={file.stem}", "data=frames", f"data.root={tmp_path}", f"run_dir={tmp_path}/run")
            assert "does not exist" in result.stderr, result.stderr  # composed, checked, and then found no data


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
