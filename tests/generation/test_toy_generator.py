"""A generator of one file is trained, monitored, saved, sampled and evaluated; no other file knows of it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from hydra.utils import instantiate
from torch import Tensor, nn

from grabnet.body.hand import HandParameters
from grabnet.cli.entry import compose
from grabnet.errors import UserError
from grabnet.generation.grabber import Grabber
from grabnet.geometry.placed import PlacedObjects
from grabnet.geometry.rotations import six_d_to_matrix
from grabnet.io.npz import read_npz
from grabnet.models.generator import GraspGenerator, SavedNetwork
from grabnet.models.trained import find_model
from grabnet.models.weights import NETWORKS, load_network
from grabnet.training.modules import GraspTraining
from grabnet.training.run import train
from tests.tiny import tiny_overrides


class ToyNet(GraspGenerator, SavedNetwork):
    """A linear layer from an object's size and noise to a nearly flat hand."""

    def __init__(self, noise_dim: int = 3):
        super().__init__()
        self.noise_dim = noise_dim
        self.register_buffer("probes", 0.1 * torch.eye(3))
        self.layer = nn.Linear(3 + noise_dim, 6 + 3)

    def arguments(self) -> dict[str, int | float]:
        return {"noise_dim": self.noise_dim}

    def encode(self, objects: PlacedObjects) -> Tensor:
        return objects.basis_distances(self.probes)

    def sample(self, code: Tensor, objects: PlacedObjects, noise: Tensor, rest: Tensor) -> HandParameters:
        six_d, transl = self.layer(torch.cat([code, noise], 1)).split([6, 3], 1)
        fingers = torch.eye(3, device=code.device).expand(len(code), 15, 3, 3)
        return HandParameters(six_d_to_matrix(six_d + six_d.new_tensor([1.0, 0, 0, 1, 0, 0])), fingers, 0.1 * transl)


class ToyTraining(GraspTraining):
    """Draws hands, and pulls them to the true ones."""

    def __init__(self, hand, contact, optimizer, scheduler, network=ToyNet):
        super().__init__(network(), nn.Identity(), hand, optimizer, scheduler, trained={})

    def reconstruct(self, batch):
        return None, {"vertex": (self.grasp(batch) - batch.vertices).abs().mean()}


class Mute(ToyNet):
    """Does not say what rebuilds it."""

    def arguments(self):
        return {"depth": 3}


class Clumsy(ToyNet):
    def sample(self, code, objects, noise, rest):
        return super().sample(code[:1], objects, noise, rest)


class Silent(SavedNetwork):
    """No generator."""

    def __init__(self):
        super().__init__()
        self.layer = nn.Linear(2, 2)

    def arguments(self):
        return {}


class Stranger(ToyNet):
    """In no register."""


@pytest.fixture(scope="module")
def configs(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("configs")
    optimizer = {"_target_": "torch.optim.Adam", "_partial_": True, "lr": 0.01}
    config = {"_target_": f"{__name__}.ToyTraining", "optimizer": optimizer}
    (folder / "model").mkdir()
    (folder / "model" / "toy.yaml").write_text(yaml.safe_dump(config))
    return folder


@pytest.fixture(scope="module", autouse=True)
def registered():
    """The one line that a new network adds."""
    with pytest.MonkeyPatch.context() as patch:
        for network in (ToyNet, Mute, Clumsy, Silent):
            patch.setitem(NETWORKS, network.__name__, network)
        yield


@pytest.fixture(scope="module")
def config(configs, tiny_dataset, cache_dir):
    def config(run_dir: Path, *more: str):
        tiny = [o for o in tiny_overrides(tiny_dataset, run_dir, cache_dir, "toy") if not o.startswith("model.")]
        return compose("train", [*tiny, f"hydra.searchpath=[file://{configs}]", *more])

    return config


@pytest.fixture(scope="module")
def run(config, tmp_path_factory) -> Path:
    run_dir = tmp_path_factory.mktemp("runs") / "toy"
    train(config(run_dir))
    return run_dir


def test_it_learns_and_its_grasps_are_monitored(run):
    history = json.loads((run / "history.json").read_text())
    assert history[-1]["val/loss"] < history[0]["val/loss"]
    assert {"val_grasps/max_penetration_mm", "val_grasps/pinched"} <= history[0].keys()
    assert not any("v2v" in name for name in history[0])  # it reconstructs nothing


def test_it_is_found_and_rebuilt_from_its_file(run, hand):
    assert find_model(run) == find_model("newest", run.parent) == {"ToyNet": run / "model.safetensors"}
    network = load_network(run, hand)
    assert type(network) is ToyNet and not network.training


def test_it_is_sampled(run, hand, cache_dir, tiny_dataset, tmp_path):
    """By the script's own function; grasp i is the network's output for noise i."""
    mesh = tiny_dataset / "tools/object_meshes/contact_meshes/block.ply"
    values = [
        f"mesh={mesh}",
        f"model={run}",
        f"output={tmp_path}",
        f"cache_dir={cache_dir}",
        "n=3",
        "page=0",
        "sheet=0",
    ]
    from grabnet.generation.run import run as sample

    assert (
        sample(
            instantiate(
                compose(
                    "sample/sample", [*values, "orientation=fixed", "optimise=0", "candidates=1", "page=0", "sheet=0"]
                ),
                _convert_="all",
            )
        )
        == 0
    )
    grasps = read_npz(tmp_path / "block" / "grasps.npz")
    network = load_network(run, hand)
    sides = torch.tensor([0.05, 0.06, 0.08])
    code = (0.1 - sides / 2).expand(3, 3)  # from the probes on the axes to the faces
    noise = torch.tensor(np.random.default_rng([0, 0]).standard_normal((3, 3), np.float32))
    with torch.no_grad():
        expected = network.sample(code, None, noise, hand.v_template)
    np.testing.assert_allclose(grasps["transl"], expected.transl, atol=2e-3)


def test_it_is_evaluated(run, tiny_dataset, cache_dir, tmp_path):
    from grabnet.evaluation.run import run as evaluate

    values = ["data=frames", f"data.root={tiny_dataset}", "data.split.val=[can]", "data.split.test=[ring]"]
    values += ["data.object_points=64", f"data.cache_dir={cache_dir}", f"cache_dir={cache_dir}", f"output={tmp_path}"]
    values += [
        f"models=[{run}]",
        "n=3",
        "optimise=0",
        "candidates=1",
        "draws=20",
        "pictures=0",
        "scenes=0",
        "processes=1",
        "simulated=0",
    ]
    assert evaluate(instantiate(compose("evaluate", values), _convert_="object")) == 0
    found = json.loads((tmp_path / "metrics.json").read_text())
    assert list(found["rows"]) == ["Ground truth", "Naive baseline", "ToyNet"]
    assert "reconstruction" not in found  # it gives none back
    assert "ToyNet" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize(
    ("network", "said"),
    [
        (Stranger, r"Stranger cannot be saved: add it to NETWORKS in grabnet/models/weights\.py, which has CoarseNet"),
        (Mute, r"Mute cannot be rebuilt from its own arguments\(\) and weights: .*depth"),
        (Clumsy, r"ToyTraining makes no grasps: .* fails \(RuntimeError"),
        (Silent, r"ToyTraining makes no grasps: .* fails \(AttributeError"),
    ],
)
def test_what_could_not_be_used_is_refused_before_it_is_trained(config, tmp_path, network, said):
    target = f"+model.network={{_target_: hydra.utils.get_class, path: {__name__}.{network.__name__}}}"
    with pytest.raises(UserError, match=said):
        train(config(tmp_path, target))
    assert not (tmp_path / "history.json").exists()


def test_results_are_ordinary_tensors(run, hand, tiny_dataset, cache_dir, tmp_path):
    """Something can be optimised from them, and they are written as the script writes them."""
    mesh = tiny_dataset / "tools/object_meshes/contact_meshes/block.ply"
    grasps = Grabber.from_pretrained(run, hand, optimise=0, candidates=1)(mesh, 2, cache_dir=cache_dir)
    transl = grasps.parameters.transl.clone().requires_grad_()
    hand(grasps.parameters._replace(transl=transl)).vertices.square().mean().backward()
    assert transl.grad.abs().sum() > 0
    assert repr(grasps).startswith("<2 grasps, thumb and a finger touch in")
    (tmp_path / "notes.txt").write_text("mine")
    grasps.save(tmp_path, formats=["ply"], name="block")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["grasps.json", "grasps.npz", "meshes", "notes.txt"]
    assert json.loads((tmp_path / "grasps.json").read_text())["name"] == "block"
    with pytest.raises(UserError, match="format is 'fbx'"):
        grasps.save(tmp_path, formats=["fbx"])
    assert (tmp_path / "meshes" / "hand_001.ply").exists()
