"""From networks and folders of grasps to report and tables, as a user calls it."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from hydra.errors import InstantiationException
from hydra.utils import instantiate

from grabnet.body.hand import HandModel
from grabnet.cli.entry import compose
from grabnet.data.objects import OBJECT_MESHES
from grabnet.errors import UserError
from grabnet.evaluation.generated import read_grasps
from grabnet.evaluation.run import run
from grabnet.generation.grabber import Grabber
from grabnet.geometry.mesh import load_mesh
from grabnet.geometry.rotations import matrix_to_axis_angle
from grabnet.io.files import sha256
from grabnet.models.weights import save_network

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def runs(grabber, tmp_path_factory) -> Path:
    runs = tmp_path_factory.mktemp("runs")
    save_network(runs / "coarse" / "model.safetensors", grabber.generator.coarsenet, {})
    save_network(runs / "fine" / "model.safetensors", grabber.generator.refinenet, {})
    return runs


@pytest.fixture(scope="module")
def arguments(runs, tiny_dataset, cache_dir) -> list[str]:
    """For four grasps of the ring, those of the can being for validation."""
    few = [
        "n=4",
        "halo_samples=3",
        "draws=50",
        "pictures=0",
        "scenes=1",
        "processes=1",
        "reconstruction=false",
        "optimise=0",
        "candidates=1",
    ]
    data = ["data=frames", f"data.root={tiny_dataset}", "data.split.val=[can]", "data.split.test=[ring]"]
    places = ["models=[newest]", f"runs={runs}", f"cache_dir={cache_dir}", f"data.cache_dir={cache_dir}"]
    return [*data, "data.object_points=64", *few, "simulated=0", *places]


@pytest.fixture(scope="module")
def call(arguments, tmp_path_factory):
    """Evaluate with these arguments and further ones."""

    def call(*overrides: str, exit_code: int = 0) -> Path:
        output = tmp_path_factory.mktemp("evaluation")
        cfg = compose("evaluate", [*arguments, f"output={output}", *overrides])
        try:
            code = run(instantiate(cfg, _convert_="object"))
        except InstantiationException as error:  # how Hydra passes on what a constructor raised
            raise error.__cause__ from None
        assert code == exit_code
        return output

    return call


@pytest.fixture(scope="module")
def folder(call) -> Path:
    """Of the newest networks, with all that there is."""
    return call("reconstruction=true", "simulated=2", "pictures=1")


def results(folder: Path) -> dict:
    return json.loads((folder / "metrics.json").read_text(encoding="utf-8"))


def figures(folder: Path) -> dict:
    """Without time and place."""
    return {name: results(folder)[name] for name in ("rows", "metrics", "reconstruction", "unexpected_order")}


ROWS = ["Ground truth", "Naive baseline", "CoarseNet", "CoarseNet + RefineNet"]


def test_tables_hold_every_row_and_protocol(folder):
    found = results(folder)
    assert list(found["rows"]) == ROWS
    protocols = {name.partition("/")[0] for name in found["metrics"]}
    assert {
        "table2",
        "shake",
        "halo",
        "grasptta",
        "penetration",
        "contact",
        "posture",
        "novelty",
        "coverage",
    } <= protocols
    for metric in (
        "table2/vertices",
        "halo/volume",
        "contact/fingers",
        "posture/violations",
        "novelty/distance",
        "grasptta/displacement",
    ):
        assert list(found["metrics"][metric]["values"]) == ROWS
    for entry in found["metrics"].values():
        for row in entry["values"].values():
            for cell in row.values():
                assert cell["low"] <= cell["value"] + 1e-9
                assert cell["value"] <= cell["high"] + 1e-9
    assert found["metrics"]["halo/volume"]["values"]["CoarseNet"]["ring"]["n"] == 3
    assert found["metrics"]["penetration/max"]["values"]["CoarseNet"]["ring"]["n"] == 4
    # The baseline's hands are training hands.
    assert found["metrics"]["novelty/distance"]["values"]["Naive baseline"]["all"]["value"] < 1e-4
    assert found["models"]["newest"].keys() == {"CoarseNet", "RefineNet"}
    for network in found["models"]["newest"].values():
        assert network["sha256"] == sha256(Path(network["file"]))


def test_csv_and_latex_say_what_json_says(folder):
    found = results(folder)
    with (folder / "metrics.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    for line in lines:
        if line["protocol"] == "reconstruction":
            continue
        cell = found["metrics"][f"{line['protocol']}/{line['metric']}"]["values"][line["row"]][line["object"]]
        assert float(line["value"]) == cell["value"]
        assert int(line["n"]) == cell["n"]
    assert sum(line["protocol"] == "reconstruction" for line in lines) == 4 * len(found["reconstruction"])
    latex = (folder / "tables.tex").read_text(encoding="utf-8")
    rows = [line for line in latex.splitlines() if line.endswith(r"\\")]
    assert sum(line.startswith("CoarseNet + RefineNet &") for line in rows) == 1
    assert not re.search(r"(?<!\\)_", "".join(rows))


def test_grasps_csv_gives_the_means(folder):
    with (folder / "grasps.csv").open(encoding="utf-8") as file:
        lines = [line for line in csv.DictReader(file) if line["row"] == "CoarseNet"]
    assert len(lines) == 4
    mean = np.mean([float(line["penetration/max (mm)"]) for line in lines])
    assert mean == pytest.approx(results(folder)["metrics"]["penetration/max"]["values"]["CoarseNet"]["all"]["value"])


def test_the_report_is_one_page_that_fetches_nothing(folder):
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"""(src|href)=["'](?!data:|#)""", page)
    assert "://" not in re.sub(r"<pre>.*?</pre>", "", re.sub(r"base64,[^\"]*", "", page), flags=re.S)
    for row in ROWS:
        assert row in page
    for title in ("At a glance", "Reconstruction", "Closest ground truth", "Contact", "Definitions"):
        assert f"<h2>{title}</h2>" in page


def test_contact_is_written_with_the_meshes(folder, tiny_dataset):
    place = folder / "contact" / "ground_truth"
    maps = np.load(place / "ring.npz")
    ring = load_mesh(tiny_dataset / OBJECT_MESHES / "ring.ply")
    assert maps["object"].shape == (4, len(ring.vertices))
    assert maps["hand"].shape == maps["hand_vertices"].shape[:2]
    assert maps["object"].any()
    assert set(np.unique(maps["hand"])) <= {0, 22, *range(41, 56)}
    solid = trimesh.load(place / "ring.ply", process=False)
    share = solid.metadata["_ply_raw"]["vertex"]["data"]["contact"].ravel()
    np.testing.assert_allclose(share, (maps["object"] > 0).mean(0), atol=1e-6)
    scene = trimesh.load(place / "ring_000.glb", process=False)
    touching = scene.geometry["hand"].vertex_attributes["_contact"].ravel()
    np.testing.assert_array_equal(touching, maps["hand"][0])
    assert not (place / "ring_001.glb").exists()


def test_again_it_is_the_same_and_nothing_is_measured(folder, call, monkeypatch):
    def never(*_, **__):
        raise AssertionError("was measured again")

    places = ("grabnet.evaluation.measuring._measure", "grabnet.evaluation.protocols.reconstruction.reconstruction")
    for name in places:
        monkeypatch.setattr(name, never)
    monkeypatch.setattr(Grabber, "forward", never)
    assert figures(call("reconstruction=true", "simulated=2")) == figures(folder)


def test_a_fresh_cache_and_two_processes_give_the_same(folder, call, tmp_path):
    again, before = (results(output)["metrics"] for output in (call("processes=2", f"cache_dir={tmp_path}"), folder))
    assert "halo/volume" in again
    assert again == {name: before[name] for name in again}


def test_reconstruction_is_what_a_training_run_reports(folder, runs, tiny_dataset, cache_dir, tmp_path):
    """The same networks, tested by Lightning as at the end of a run."""
    import lightning as L

    from grabnet.data.datamodule import GraspDataModule
    from grabnet.models.trained import find_network
    from grabnet.models.weights import load_network

    cfg = compose(
        "train",
        [
            "model=coarsenet",
            "data=frames",
            f"data.root={tiny_dataset}",
            "data.object_points=64",
            f"data.cache_dir={cache_dir}",
            "data.split.val=[can]",
            "data.split.test=[ring]",
        ],
    )
    data: GraspDataModule = instantiate(cfg.data, hand=HandModel.open())
    data.setup()
    errors = {(e["network"], e["split"], e["object"]): e for e in results(folder)["reconstruction"]}
    for kind, model in (("CoarseNet", cfg.model), ("RefineNet", compose("train", ["model=refinenet"]).model)):
        module = instantiate(model, hand=data.hand, contact=data.contact)
        module.network = load_network(find_network(kind, None, runs), data.hand, kind)
        trainer = L.Trainer(logger=False, enable_progress_bar=False, accelerator="cpu", default_root_dir=tmp_path)
        trainer.test(module, datamodule=data, verbose=False)
        for split in ("train", "val", "test"):
            for name in ("v2v", "v2v_mae", "published_v2v", "published_v2v_mae"):
                tested = float(trainer.callback_metrics[f"test/{split}/{name}"])
                assert errors[kind, split, "all"][name] == pytest.approx(tested, rel=1e-5)
        frames = [e["n"] for (k, _, name), e in errors.items() if k == kind and name == "all"]
        assert frames == [len(data.frames(s)) for s in ("train", "val", "test")]


@pytest.fixture
def made(tmp_path, grabber, tiny_dataset, cache_dir) -> Path:
    """The same grasps of the ring as parameters and as meshes."""
    file = tiny_dataset / OBJECT_MESHES / "ring.ply"
    grasps = grabber(load_mesh(file), 3, cache_dir=cache_dir)
    parameters, meshes = tmp_path / "parameters" / "ring", tmp_path / "meshes" / "ring"
    parameters.mkdir(parents=True)
    meshes.mkdir(parents=True)
    pose = grasps.parameters
    np.savez(
        parameters / "grasps.npz",
        global_orient=matrix_to_axis_angle(pose.global_orient),
        hand_pose=matrix_to_axis_angle(pose.hand_pose).flatten(1),
        transl=pose.transl,
        betas=grasps.betas,
    )
    for i, vertices in enumerate(grasps.vertices.numpy()):
        hand = trimesh.Trimesh(vertices, grasps.faces.numpy(), process=False)
        hand.export(meshes / f"hand_{i}.{'ply' if i else 'obj'}", **({} if i else {"digits": 9}))
    return tmp_path


def test_grasps_of_other_methods(call, made):
    output = call("models=[]", f"grasps=[{made / 'parameters'},{made / 'meshes'}]")
    found = results(output)
    assert list(found["rows"]) == ["Ground truth", "Naive baseline", "parameters", "meshes"]
    for metric in ("table2/vertices", "halo/volume", "halo/depth", "contact/area", "novelty/distance"):
        values = found["metrics"][metric]["values"]
        assert values["parameters"]["all"]["value"] == pytest.approx(values["meshes"]["all"]["value"], rel=1e-3)
    # Meshes have no joint angles.
    assert "meshes" not in found["metrics"]["posture/violations"]["values"]


def test_hands_that_do_not_touch_give_zeros(call, made, tmp_path):
    (tmp_path / "apart" / "ring").mkdir(parents=True)
    for i in range(2):
        mesh = trimesh.load(made / "meshes" / "ring" / f"hand_{i + 1}.ply", process=False)
        mesh.vertices += 0.15
        mesh.export(tmp_path / "apart" / "ring" / f"{i}.ply")
    found = results(call("models=[]", f"grasps={tmp_path / 'apart'}", "simulated=2"))
    none = ["halo/volume", "halo/depth", "halo/contact", "grasptta/volume", "grasptta/contact", "contact/area"]
    none += ["contact/fingers", "contact/pinched", "penetration/max", "penetration/mean", "shake/success"]
    none += ["shake/failed", "grasptta/failed"]
    values = {name: found["metrics"][name]["values"]["apart"]["all"]["value"] for name in none}
    assert values == dict.fromkeys(none, 0)
    displacement = found["metrics"]["grasptta/displacement"]["values"]["apart"]["all"]["value"]
    assert displacement == pytest.approx(10.73, abs=0.01)
    assert found["failures"] == []


def test_an_object_that_cannot_be_cut_is_reported_and_the_rest_goes_on(call, made, capsys):
    """CoACD has a second: enough for the can, which is convex, and not for the ring."""
    shutil.copytree(made / "parameters" / "ring", made / "parameters" / "can")
    endless = [f"physics.decomposition.{name}" for name in ("time_limit=2", "nodes=50", "iterations=100000")]
    objects = ["data.split.test=[ring,can]", "data.split.val=[]"]
    output = call("models=[]", f"grasps={made / 'parameters'}", "simulated=2", *endless, *objects, exit_code=1)
    found = results(output)
    (sentence,) = found["failures"]
    assert re.match(r"ring: grasptta and shake and volco failed for 6 of 6 grasps: .*not done after 2 s", sentence)
    assert sentence in (output / "report.html").read_text(encoding="utf-8").replace("&#x27;", "'")
    assert f"error: {sentence}" in capsys.readouterr().err
    values = {name: found["metrics"][name]["values"]["parameters"] for name in ("shake/failed", "shake/displacement")}
    assert values["shake/failed"]["ring"]["value"] == 100
    assert values["shake/failed"]["can"]["value"] == 0
    assert set(values["shake/displacement"]) == {"can", "all"}
    assert found["metrics"]["halo/volume"]["values"]["parameters"]["ring"]["n"] == 3


def test_a_folder_without_an_object_is_reported_and_the_rest_goes_on(arguments, made, tmp_path):
    """By the command line: exit code 1, since some failed."""
    objects = ["data.split.test=[ring,can]", "data.split.val=[]"]
    given = [*arguments, "models=[]", *objects, f"grasps={made / 'parameters'}", f"output={tmp_path / 'output'}"]
    command = [sys.executable, str(ROOT / "scripts" / "evaluate.py"), *given]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    assert done.returncode == 1, done.stderr
    assert "error: parameters has no grasps of can" in done.stderr
    found = results(tmp_path / "output")
    assert found["rows"]["parameters"].endswith("which has none of can")
    assert set(found["metrics"]["penetration/max"]["values"]["parameters"]) == {"ring", "all"}


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda p: shutil.rmtree(p / "meshes" / "ring"), "no folder called like an object"),
        (lambda p: [f.unlink() for f in (p / "meshes" / "ring").iterdir()], "neither grasps.npz nor hand meshes"),
        (lambda p: trimesh.creation.box().export(p / "meshes" / "ring" / "hand_1.ply"), "one topology"),
        (lambda p: np.savez(p / "meshes" / "ring" / "grasps.npz", transl=np.zeros((2, 3))), "has no global_orient"),
        (
            lambda p: np.savez(
                p / "meshes" / "ring" / "grasps.npz",
                global_orient=np.zeros((2, 3)),
                hand_pose=np.zeros((2, 24)),
                transl=np.zeros((2, 3)),
            ),
            r"hand_pose has shape \(2, 24\)",
        ),
    ],
)
def test_unusable_grasps_are_refused(call, made, spoil, sentence):
    spoil(made)
    with pytest.raises(UserError, match=sentence):
        call("models=[]", f"grasps={made / 'meshes'}")


@pytest.mark.parametrize(
    ("scale", "offset", "sentence"),
    [
        (1000, 0, "largest side of .*divide by 1000 if it is in millimetres"),
        (100, 0, "divide by 100 if it is in centimetres"),
        (10, 0, "divide by 10 if it is in decimetres"),
        (0.01, 0, "check its pose, shape and units"),
        (1, 1.0, "m away from the object: give hands in metres, in the frame of .*ring.ply"),
        (1, -0.4, "away from the object"),
        (1, 1e6, "from its origin"),
    ],
)
def test_hands_in_other_units_and_frames_are_refused(made, tiny_dataset, hand, scale, offset, sentence):
    """The last hand of a folder alone: none of them counts without being looked at."""
    file = made / "meshes" / "ring" / "hand_2.ply"
    mesh = trimesh.load(file, process=False)
    mesh.vertices = scale * mesh.vertices + offset
    mesh.export(file)
    with pytest.raises(UserError, match=f"{file} .*{sentence}"):
        read_grasps(made / "meshes", "ring", tiny_dataset / OBJECT_MESHES / "ring.ply", hand, 100)


def _with(name, change):
    """Spoil one array of the parameters."""

    def spoil(file):
        values = dict(np.load(file))
        np.savez(file, **values | {name: change(values[name])})

    return spoil


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (_with("betas", lambda b: b * np.nan), "betas of grasp 0 are not all finite"),
        (_with("betas", lambda b: b + np.array([[0], [0], [np.inf]])), "betas of grasp 2 are not all finite"),
        (_with("betas", lambda b: b + np.array([[0], [1e38], [0]])), "grasp 1 "),
        (_with("betas", lambda b: b + 1000), "grasp 0 has a largest side of .* no hand has"),
        (_with("betas", lambda b: b[:2]), r"betas has shape \(2, 10\)"),
        (_with("betas", lambda b: np.zeros((3, 11))), r"betas has shape \(3, 11\); \(N, up to 10\)"),
        (_with("betas", lambda b: b.astype(str)), "finite numbers are needed"),
        (_with("transl", lambda t: 1000 * t), "divide transl by 1000 if it is in millimetres"),
        (_with("transl", lambda t: 100 * t), "divide transl by 100 if it is in centimetres"),
        (_with("transl", lambda t: t + 2 * np.eye(3)), "grasp 0 is .* away from the object"),
        (_with("transl", lambda t: t + 1e30), "grasp 0 "),
        (_with("transl", lambda t: t.astype(float) + 1e300), "transl of grasp 0 are not all finite"),
        (_with("transl", lambda t: np.float32(3)), r"transl has shape \(\)"),
        (_with("global_orient", lambda r: r * np.nan), "global_orient of grasp 0"),
        (_with("hand_pose", lambda p: np.full_like(p, -np.inf)), "hand_pose of grasp 0"),
    ],
)
def test_parameters_that_pose_no_hand_are_refused(made, tiny_dataset, hand, spoil, sentence):
    spoil(made / "parameters" / "ring" / "grasps.npz")
    with pytest.raises(UserError, match=f"grasps.npz: .*{sentence}"):
        read_grasps(made / "parameters", "ring", tiny_dataset / OBJECT_MESHES / "ring.ply", hand, 100)


def test_grasps_for_another_mesh_are_refused(call, made):
    (made / "parameters" / "ring" / "grasps.json").write_text(json.dumps({"mesh_sha256": "0" * 64}))
    with pytest.raises(UserError, match="made for another mesh"):
        call("models=[]", f"grasps={made / 'parameters'}")


def test_poses_of_another_hand_are_refused(call, made):
    record = made / "parameters" / "ring" / "grasps.json"
    record.write_text(json.dumps({"hand_sha256": "0" * 64}))
    with pytest.raises(UserError, match="are poses of another hand model: give them as meshes"):
        call("models=[]", f"grasps={made / 'parameters'}")
    record.write_text(json.dumps({"hand_sha256": HandModel.open().fingerprint}))
    call("models=[]", f"grasps={made / 'parameters'}")


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        ("n=0", "at least 1"),
        ("split=tests", "it can be train, val, test"),
        ("only=[mug]", "only names mug; the test objects are ring"),
        ("models=[anywhere]", "anywhere does not exist"),
        ("device=tpu", "it can be auto, cpu, cuda"),
        ("contact_distance=0", "must be above 0"),
    ],
)
def test_wrong_values_are_refused(call, override, sentence):
    with pytest.raises(UserError, match=sentence):
        call(override)


def test_metrics_and_data_share_one_distance_of_contact(arguments):
    cfg = compose("evaluate", [*arguments, "data.contact_distance=0.003"])
    assert cfg.contact_distance == 0.003


def test_poses_turned_by_hand(made, tiny_dataset, hand):
    """Parameters are posed as any model of MANO's schema would be."""
    hands = read_grasps(made / "parameters", "ring", tiny_dataset / OBJECT_MESHES / "ring.ply", hand, 2)
    meshes = read_grasps(made / "meshes", "ring", tiny_dataset / OBJECT_MESHES / "ring.ply", hand, 2)
    assert len(hands) == 2
    np.testing.assert_allclose(hands.vertices, meshes.vertices, atol=1e-5)
    assert read_grasps(made / "meshes", "can", tiny_dataset / OBJECT_MESHES / "can.ply", hand, 2) is None
    assert torch.as_tensor(hands.hand_pose).shape == (2, 15, 3, 3)


def test_rows_show_what_optimisation_candidates_and_learning_add(call):
    found = results(call("optimise=2", "candidates=2", "n=2"))
    assert list(found["rows"]) == [
        "Ground truth",
        "Naive baseline",
        "Naive baseline, optimised, best of 2",
        "Templates, optimised, best of 2",
        "CoarseNet",
        "CoarseNet + RefineNet",
        "CoarseNet + RefineNet, optimised",
        "CoarseNet + RefineNet, optimised, best of 2",
    ]
