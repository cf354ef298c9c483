"""What a network is trained with travels in its weights: from the config to sampling, training on and evaluation."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch
import trimesh
from hydra.utils import instantiate
from safetensors import safe_open
from safetensors.torch import save_file
from scipy.spatial import cKDTree

from grabnet.body.hand import OPEN_HANDS, HandModel
from grabnet.cli.entry import compose
from grabnet.data.datamodule import GraspDataModule
from grabnet.data.objects import OBJECT_MESHES
from grabnet.data.splits import Split
from grabnet.errors import UserError
from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.protocols.reconstruction import Reconstruction
from grabnet.generation.grabber import Grabber
from grabnet.geometry.conventions import Conventions
from grabnet.models.trained import find_model, load_model
from grabnet.models.weights import FILE_NAME, load_network, read_conventions, save_network
from grabnet.training.run import train
from tests.tiny import tiny_overrides

OTHERWISE = ("data.centre=box", "data.distance_to=samples", "data.basis_to=samples", "data.object_points=300",
             "data.points_in_use=400", "data.rotate=false")  # fmt: skip
EVALUATION = ("data=frames", "data.split.val=[can]", "data.split.test=[ring]", "data.object_points=64")
QUICK = ("trainer.max_epochs=1", "test=false")


@pytest.fixture(scope="module")
def dataset(tiny_dataset, tmp_path_factory):
    """The tiny data set, its block with most vertices at one end."""
    root = shutil.copytree(tiny_dataset, tmp_path_factory.mktemp("uneven") / "data")
    block = trimesh.creation.box((0.05, 0.06, 0.08)).subdivide().subdivide([0, 1, 2, 3, 4, 5])
    block.export(root / OBJECT_MESHES / "block.ply")
    return root


@pytest.fixture(scope="module")
def runs(dataset, cache_dir, tmp_path_factory):
    """Both networks, trained by other conventions than the default ones."""
    runs = tmp_path_factory.mktemp("runs")
    for model in ("coarsenet", "refinenet"):
        train(compose("train", tiny_overrides(dataset, runs / model, cache_dir, model, *OTHERWISE, *QUICK)))
    return runs


def test_the_weights_say_what_they_were_trained_with(runs, hand):
    expected = Conventions("box", "samples", "samples", 300, 400, False, hand.fingerprint)
    for model in ("coarsenet", "refinenet"):
        assert read_conventions(runs / model) == expected
        with safe_open(runs / model / FILE_NAME, "pt") as file:
            assert json.loads(file.metadata()["conventions"]) == asdict(expected)
    assert load_model(find_model(runs), hand).conventions == expected


def test_files_that_do_not_say_it_mean_the_defaults(runs, tmp_path, hand):
    with safe_open(runs / "coarsenet" / FILE_NAME, "pt") as file:
        header = file.metadata()
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    del header["conventions"]
    save_file(tensors, tmp_path / FILE_NAME, header)
    assert load_model(find_model(tmp_path), hand).conventions == Conventions()
    for held, said in (
        ('{"centre": "top"}', "data.centre is 'top'"),
        ('{"gravity": 9.81}', "gravity"),
        ("[", "Expect"),
    ):
        save_file(tensors, tmp_path / FILE_NAME, header | {"conventions": held})
        with pytest.raises(UserError, match=rf"was trained with conventions that are not known here \(.*{said}"):
            load_model(find_model(tmp_path), hand)


def test_grasps_are_drawn_by_them(runs, dataset, cache_dir, hand):
    """Both networks called by hand, on points chosen and compared here."""
    file = dataset / OBJECT_MESHES / "block.ply"
    grabber = Grabber.from_pretrained(runs, hand, batch_size=4, optimise=0, candidates=1)
    grasps = grabber(file, 4, 2, orientation="fixed", cache_dir=cache_dir)
    mesh = trimesh.load(file, process=False)
    known = grabber.generator.conventions
    points = known.vertices_in_use(grasps.mesh).numpy()
    assert len(points) == 400 and np.linalg.norm(mesh.vertices.mean(0) - mesh.bounds.mean(0)) > 0.002
    tree = cKDTree(points)

    def nearest(x):
        return torch.from_numpy(tree.query(x.numpy())[0]).float()

    model = grabber.generator
    latent = torch.from_numpy(np.random.default_rng([2, 0]).standard_normal((4, model.noise_dim), np.float32))
    with torch.no_grad():
        guess = model.coarsenet.decode(latent, nearest(model.coarsenet.bps.basis).expand(4, -1))
        vertices = hand(model.refinenet(guess, nearest)).vertices
    torch.testing.assert_close(grasps.vertices, vertices + torch.tensor(mesh.bounds.mean(0)).float(), atol=1e-5, rtol=0)


def test_hand_and_object_stay_where_they_are_to_each_other(dataset, cache_dir, hand):
    """About another centre: hands, what they are to the object, and the noisy ones that a store may hold."""
    made = {}
    for centre in ("mean_vertex", "box"):
        split = Split("object", ["can"], ["ring"])
        data = GraspDataModule(hand, str(dataset), split, object_points=64, centre=centre, cache_dir=str(cache_dir))
        data.setup()
        for turn in (False, True):
            torch.manual_seed(1)
            made[centre, turn] = data.assemble("train", torch.arange(96), turn=turn)
    for turn in (False, True):
        about_mean, about_box = made["mean_vertex", turn], made["box", turn]
        placed = about_mean.objects
        shift = (placed.rotations @ (about_box.objects.centres - placed.centres).unsqueeze(-1)).squeeze(-1)
        is_block = placed.index == data.store.objects.index("block")
        assert (shift[is_block].norm(dim=1) > 0.002).all() and 0 < is_block.sum() < 96
        for moved, there in ((about_box.vertices, about_mean.vertices), (about_box.points, about_mean.points)):
            torch.testing.assert_close(moved, there - shift.unsqueeze(1), atol=1e-6, rtol=0)
        for name in ("distances", "point_distances"):
            torch.testing.assert_close(getattr(about_box, name), getattr(about_mean, name), atol=3e-4, rtol=1e-3)
        found = about_box.objects.signed_distances(about_box.vertices)
        torch.testing.assert_close(found, placed.signed_distances(about_mean.vertices), atol=3e-4, rtol=1e-3)


@pytest.mark.parametrize(
    ("model", "change", "said"),
    [
        (
            "grabnet",
            "data.distance_to=surface",
            r"refinenet\S* was trained with .*distance_to=samples .*distance_to=su",
        ),
        ("grabnet", "data.centre=mean_vertex", r"coarsenet\S* was trained with data.centre=box .*centre=mean_vertex"),
        ("grabnet", "data.basis_to=surface", r"coarsenet\S* was trained with .*basis_to=samples .*basis_to=surface"),
        ("refinenet", "data.centre=mean_vertex", r"coarsenet\S* was trained with data.centre=box .*centre=mean_vertex"),
    ],
)
def test_training_on_by_others_is_refused(runs, dataset, cache_dir, tmp_path, model, change, said):
    more = [f"model.{name}={runs / name}" for name in ("coarsenet", "refinenet")]
    overrides = tiny_overrides(dataset, tmp_path, cache_dir, model, *OTHERWISE, *QUICK, change)
    if model == "grabnet":
        overrides = [o for o in overrides if not o.startswith("model.")] + more
    else:
        overrides += ["source=guesses_to_recorded", f"model.source.coarsenet={runs / 'coarsenet'}"]
    with pytest.raises(UserError, match=said):
        train(compose("train", overrides))
    assert not (tmp_path / "history.json").exists()


def test_both_networks_train_on_by_their_own(runs, dataset, cache_dir, tmp_path):
    overrides = tiny_overrides(dataset, tmp_path, cache_dir, "grabnet", *OTHERWISE, *QUICK)
    start = [f"model.{name}={runs / name}" for name in ("coarsenet", "refinenet")]
    train(compose("train", [*(o for o in overrides if not o.startswith("model.")), *start]))
    for name in ("coarsenet", "refinenet"):
        assert read_conventions(tmp_path / name) == read_conventions(runs / name)


def test_networks_that_know_objects_otherwise_make_no_model(runs, dataset, cache_dir, tmp_path, hand):
    train(compose("train", tiny_overrides(dataset, tmp_path, cache_dir, "refinenet", *QUICK)))
    said = r"do not fit each other: RefineNet was trained with data.centre=mean_vertex .*centre=box .*trained alike"
    with pytest.raises(UserError, match=said):
        load_model(find_model([runs / "coarsenet", tmp_path]), hand)
    assert load_model(find_model([runs / "coarsenet", tmp_path]), hand, refine=False).conventions.centre == "box"


def test_a_network_of_another_hand_is_refused(runs, tmp_path):
    """Also of one with the same template."""
    with np.load(OPEN_HANDS / "MANO_RIGHT.npz") as model:
        values = dict(model)
    np.savez(tmp_path / "MANO_RIGHT.npz", **values | {"weights": np.roll(values["weights"], 1, axis=1)})
    with pytest.raises(UserError, match="was trained with another hand model"):
        load_model(find_model(runs), HandModel(tmp_path / "MANO_RIGHT.npz"))


def test_an_evaluation_shows_them_objects_as_their_training_did(runs, dataset, cache_dir, hand):
    """Reconstruction with data of the default conventions gives what the training's own data give."""
    values = [*EVALUATION, f"data.root={dataset}", f"data.cache_dir={cache_dir}", f"models=[{runs}]"]
    found = []
    for name, more in (("a", []), ("b", OTHERWISE)):
        config = compose("evaluate", [*values, *more, f"cache_dir={cache_dir / name}"])
        inputs = EvaluationInputs(instantiate(config, _convert_="object"))
        found.append(Reconstruction.of(inputs)())
    assert [(s.network, s.split, s.object) for s in found[0]] == [(s.network, s.split, s.object) for s in found[1]]
    for by_default, as_trained in zip(*found, strict=True):
        assert by_default.values == pytest.approx(as_trained.values, rel=1e-5)


def test_a_source_that_knows_objects_otherwise_is_refused(runs, dataset, cache_dir, tmp_path):
    train(compose("train", tiny_overrides(dataset, tmp_path, cache_dir, "coarsenet", *QUICK)))
    values = [*EVALUATION, f"data.root={dataset}", f"data.cache_dir={cache_dir}", f"models=[{runs}]"]
    values += ["source=guesses_to_recorded", f"source.coarsenet={tmp_path}"]
    inputs = EvaluationInputs(instantiate(compose("evaluate", [*values, f"cache_dir={tmp_path}"]), _convert_="object"))
    with pytest.raises(UserError, match=r"was trained with data.centre=mean_vertex .*centre=box"):
        Reconstruction.of(inputs)()


def test_a_source_of_another_hand_is_refused(runs, dataset, cache_dir, tmp_path):
    network = load_network(runs / "coarsenet", kind="CoarseNet")
    network.conventions = replace(network.conventions, hand="0" * 64)
    save_network(tmp_path / "model.safetensors", network, {})
    values = [*EVALUATION, f"data.root={dataset}", f"data.cache_dir={cache_dir}", f"models=[{runs}]"]
    values += ["source=guesses_to_recorded", f"source.coarsenet={tmp_path}"]
    inputs = EvaluationInputs(instantiate(compose("evaluate", [*values, f"cache_dir={tmp_path}"]), _convert_="object"))
    with pytest.raises(UserError, match="was trained with another hand model"):
        Reconstruction.of(inputs)()
