"""Config mistakes end in one sentence that names what exists."""

import subprocess
import sys
from pathlib import Path

import hydra
import pytest
import torch
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import OmegaConf

from grabnet.cli.checking import check, refusal
from grabnet.cli.ends import Stopped
from grabnet.cli.entry import CONFIGS, compose
from grabnet.commands.train import main
from grabnet.errors import UserError

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("argument", "sentence"),
    [
        ("model=corsenet", "There is no model 'corsenet'; model can be coarsenet, grabnet, refinenet"),
        ("model.latnt_dim=3", "Unknown key 'model.latnt_dim'; did you mean model.latent_dim? (model has scheduler, "),
        ("loss.vertex=3", "Unknown key 'loss.vertex'; did you mean model.loss.vertex?"),
        ("losses.vertex=3", "Unknown key 'losses.vertex'; did you mean model.loss.vertex?"),
        ("lr=1e-3", "Unknown key 'lr'; did you mean model.optimizer.lr?"),
        ("batch_size=3", "Unknown key 'batch_size'; did you mean data.batch_size?"),
        ("batchsize=3", "Unknown key 'batchsize'; did you mean data.batch_size?"),
        ("ckpt_path=x", "Unknown key 'ckpt_path'; give resume=true with run_dir=<run folder>."),
        ("nonsense=3", "Unknown key 'nonsense'; the config has seed, run_dir, "),
        ("+nonsense=3", "The config has no value nonsense; it takes seed, "),
        ("trainer.gradient_clip_val=1", "if its target takes it, write +trainer.gradient_clip_val=…"),
        ("model.latent_dim=abc", "model.latent_dim='abc' is of the wrong type: it must be an int."),
        ("data=frames", "The config value data.root must be given on the command line."),
        ("model.latent_dim=", "model.latent_dim='' is of the wrong type"),
        ("model.optimizer.lr=abc", "model.optimizer.lr='abc' is of the wrong type: it must be a float or Tensor."),
        ("trainer.max_epochs=abc", "trainer.max_epochs='abc' is of the wrong type: it must be an int or null."),
        ("test=maybe", "test='maybe' is of the wrong type: it must be true or false."),
        ("model.loss=3", "model.loss=3 is of the wrong type: it must be a config with a _target_."),
        ("loss=refinenet", "model.loss makes a RefineNetLoss; a CoarseNetLoss belongs there."),
        ("source=recorded_perturbed", "model has no value source; it takes hand, "),
        ("model=3", "model=3 names no file of the group model; it can be coarsenet, grabnet, refinenet."),
        ("logger=null", "logger=null names no file of the group logger; it can be csv, wandb."),
        ("callbacks=null", "callbacks=null names no file of the group callbacks; it can be default, pruning."),
        ("logger=[]", "logger=[] names no file of the group logger"),
        ("data=_base", "data=_base names no file of the group data; it can be frames, grabnet_release, open."),
        ("~logger", "~logger removes what the command needs: remove single values, as in ~logger.<value>."),
        ("seed=-1", "seed is -1; it must be at least 0."),
        ("seed=4294967296", "seed is 4294967296; it must be at most 4294967295."),
        ("model.bps.n_points=0", "model.bps.n_points is 0; it must be at least 1."),
        ("model.bps.radius=-1", "model.bps.radius is -1; it must be above 0."),
        ("model.width=0", "model.width is 0; it must be at least 1."),
        ("model.loss.kl=2", "model.loss.kl is 2; it must be at most 1."),
        ("model.loss.weight_exponent=-1", "model.loss.weight_exponent is -1; it must be at least 0."),
        ("model.loss.point_weights.near=[1]", "near=[1] is of the wrong type: it must be a list of 2 values."),
        ("model.optimizer.lr=-1", "model.optimizer.lr is -1; it must be above 0."),
        ("model.optimizer.lr=nan", "model.optimizer.lr is nan; it must be a finite number."),
        ("trainer.max_epochs=-5", "trainer.max_epochs is -5; it must be at least -1."),
        (
            "callbacks.grasps=x",
            "callbacks.grasps='x' is of the wrong type: it must be a config with a _target_",
        ),
        ("~model.optimizer", "~model.optimizer removes what grabnet.training.modules.CoarseNetTraining needs"),
        ("~seed", "~seed removes what grabnet.training.settings.TrainingConfig needs: give it another value instead."),
        ("run_dir=", "run_dir is ''; it must not be empty."),
        ("data.batch_size=99999999999", "data.batch_size is 99999999999; it must be at most 1000000."),
        ("objective=val(loss", "The argument objective=val(loss cannot be read: quote a value with special characters"),
        ("model.optimizer._target_=torch.optim.Nope", "model.optimizer._target_=torch.optim.Nope does not exist."),
        ("model.optimizer._target_=antigravitee.Adam", "model.optimizer._target_=antigravitee.Adam does not exist."),
        ("seed=${oc.env:GRABNET_NO_SUCH}", "seed refers to what cannot be resolved (KeyError raised while resolving "),
        ("trainer.devices=100000", "trainer.devices is 100000; it must be at most "),
        ("trainer.max_time=abc", "trainer.max_time is 'abc'; it must be null or DD:HH:MM:SS, as in 00:12:00:00."),
        (
            "trainer.precision=x",
            "it must be 64 or 32 or 16 or transformer-engine or transformer-engine-float16 or 16",
        ),
        ("trainer.precision=x", " or 64-true or bf16 or null."),
        ("seed=${nothing}", "seed refers to what cannot be resolved (Interpolation key 'nothing' not found)"),
        ("seed=${seed}", "seed refers to what cannot be resolved (Recursive interpolation detected)"),
        (
            "data.batch_size=${nothing:1}",
            "data.batch_size refers to what cannot be resolved (Unsupported interpolation",
        ),
    ],
)
def test_the_mistake_is_named(argument, sentence):
    with pytest.raises(UserError) as caught:
        compose("train", [argument])
    assert sentence in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("argument", ["model=corsenet", "seed", "seed=range(1,1)"])
def test_the_command_says_it_in_a_line_and_leaves(argument):
    result = subprocess.run([sys.executable, "train.py", "-m", argument], cwd=ROOT, capture_output=True, text=True)
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


@pytest.mark.parametrize("group", ["experiment", "model", "debug", "trainer", "callbacks", "logger", "scheduler"])
def test_every_choice_composes(group):
    for file in (CONFIGS / group).glob("*.yaml"):
        assert compose("train", [f"{group}={file.stem}"])


def test_groups_within_the_model_are_chosen_by_their_plain_names():
    targets = {
        ("train", "scheduler=cosine"): ("model.scheduler", "CosineAnnealingLR"),
        ("train", "loss=coarsenet"): ("model.loss", "CoarseNetLoss"),
        ("train", "model=refinenet"): ("model.source", "RecordedPerturbed"),
        ("train", "model=refinenet source=published"): ("model.source", "StoredNoise"),
        ("train", "model=refinenet source=samples_perturbed model.source.coarsenet=a"): (
            "model.source",
            "SamplesPerturbed",
        ),
        ("train", "experiment=demo_refinenet"): ("model.source", "CoarseNetGuesses"),
        ("train", "model=grabnet"): ("model.coarse_loss", "CoarseNetLoss"),
        ("evaluate", "source=published"): ("source", "StoredNoise"),
    }
    for (command, arguments), (key, name) in targets.items():
        assert OmegaConf.select(compose(command, arguments.split()), key)._target_.endswith(f".{name}"), arguments


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["model.loss.point_weights.near=[1,0]"], "near is [1, 0]; its first distance must be below its second."),
        (["model.loss.contact_weights=x"], "contact_weights is 'x'; it can be learned or uniform."),
    ],
)
def test_what_a_constructor_refuses_is_told(arguments, sentence, hand):
    cfg = compose("train", arguments)
    with pytest.raises(InstantiationException) as caught:
        instantiate(cfg.model, hand=hand, contact=torch.ones(len(hand.v_template)))
    assert str(refusal(caught.value)) == sentence


def sample_target(size: int, rate: float = 0.1, name: str | None = None) -> None: ...


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"size": "3"}, r"node\.size='3' is of the wrong type: it must be an int"),
        ({"size": 3, "rate": True}, r"node\.rate=true is of the wrong type: it must be a float"),
        ({"size": True}, r"node\.size=true"),
        ({"size": 3, "sise": 3}, "node has no value sise; it takes size, rate, name"),
        ({"size": "???"}, r"node\.size must be given"),
    ],
)
def test_values_are_held_against_the_signature(values, sentence):
    node = {"_target_": f"{__name__}.sample_target", **values}
    with pytest.raises(UserError, match=sentence):
        check(OmegaConf.create({"node": node}))


@pytest.mark.parametrize(
    ("line", "kind", "sentence"),
    [
        ("raise Stopped(15)", Stopped, "stopped by SIGTERM."),
        ("raise MemoryError", UserError, "The memory does not suffice"),
        ("open('/nowhere/x')", UserError, "/nowhere/x cannot be used (No such file or directory)"),
        ("1 / 0", UserError, "_target_=raising.Adam cannot be imported (division by zero)."),
    ],
)
def test_what_ends_an_import_is_said_as_it_is(line, kind, sentence, tmp_path, monkeypatch):
    (tmp_path / "raising.py").write_text(f"from grabnet.cli.ends import Stopped\n{line}\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(kind) as caught:
        check(OmegaConf.create({"node": {"_target_": "raising.Adam"}}))
    assert sentence in str(caught.value)


def test_good_values_pass():
    node = {"_target_": f"{__name__}.sample_target", "size": 3, "rate": 1, "name": None}
    check(OmegaConf.create({"node": node, "list": [node]}))


def test_a_command_may_compose_the_config_of_another():
    with hydra.initialize_config_dir(str(CONFIGS), version_base="1.3"):
        running = GlobalHydra.instance().hydra
        assert compose("train", ["run_dir=x"]).seed == 0
        assert GlobalHydra.instance().hydra is running


@pytest.mark.parametrize("model", ["coarsenet", "refinenet"])
def test_the_papers_experiment_has_the_published_values(model):
    """Ref. 7, value by value; and the other experiment differs from it in three."""
    paper = compose("train", [f"model={model}", "experiment=paper"])
    published = {
        "data.distance_to": "samples",
        "data.rotate": False,
        "data.object_points": 2048,
        "data.batch_size": 256,
        "model.optimizer.lr": 5e-4,
        "model.optimizer.weight_decay": 5e-4,
        "model.scheduler.factor": 0.1,
        "model.scheduler.patience": 10,
        "callbacks.early_stopping.patience": 8,
        "model.loss.hand_to_object": 35,
    }
    weights = {"coarsenet": {"vertex": 35, "edge": 30, "object_to_hand": 30, "kl": 5e-3, "weight_exponent": 1 / 2.5}}
    weights["refinenet"] = {"vertex": 20, "edge": 10, "scale": 1 - 5e-3, "weight_exponent": 1 / 2.5}
    published |= {f"model.loss.{name}": value for name, value in weights[model].items()}
    for key, value in published.items():
        assert OmegaConf.select(paper, key) == value, key
    ours = compose("train", [f"model={model}", "experiment=surface_rotated"])
    differing = {key for key in published if OmegaConf.select(ours, key) != OmegaConf.select(paper, key)}
    assert differing == {"data.distance_to", "data.rotate", "model.scheduler.patience"}
    assert {key for key in paper.data if key != "source" and paper.data[key] != ours.data[key]} == {
        "distance_to",
        "rotate",
    }
