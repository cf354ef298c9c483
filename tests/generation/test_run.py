"""From mesh files to result folders, as a user calls it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from omegaconf import OmegaConf

from grabnet.cli.entry import CONFIGS
from grabnet.errors import UserError
from grabnet.generation.config import SamplingConfig
from grabnet.generation.export import write_grasps
from grabnet.generation.run import run as sample
from grabnet.io.files import sha256
from grabnet.io.npz import read_npz
from grabnet.models.weights import save_network

INPUTS = Path(__file__).parents[1] / "geometry" / "inputs"
SCRIPT = CONFIGS.parent / "scripts" / "sample.py"


@pytest.fixture(scope="module")
def runs(grabber, tmp_path_factory) -> Path:
    runs = tmp_path_factory.mktemp("runs")
    save_network(runs / "coarse" / "model.safetensors", grabber.generator.coarsenet, {})
    save_network(runs / "fine" / "model.safetensors", grabber.generator.refinenet, {})
    return runs


@pytest.fixture
def call(runs, cache_dir, tmp_path):
    """Sample with the config's own values, but for a few grasps and those given."""
    config = OmegaConf.to_container(OmegaConf.load(CONFIGS / "sample" / "sample.yaml"))
    defaults = {k: v for k, v in config.items() if k not in ("_target_", "defaults", "hydra")}
    few = {"n": 2, "model": "newest", "runs": str(runs), "cache_dir": str(cache_dir), "output": str(tmp_path / "out")}
    quick = {"sheet": 0, "page": 0, "format": None, "batch_size": 4, "optimise": 0, "candidates": 1}

    def call(**values) -> int:
        return sample(SamplingConfig(**(defaults | few | quick | values)))

    return call


@pytest.fixture
def folder(tmp_path) -> Path:
    """Meshes of all kinds, good and bad."""
    folder = tmp_path / "meshes"
    (folder / "other").mkdir(parents=True)
    ball = trimesh.creation.icosphere(2, 0.04)
    for name in ("ball.obj", "b ü (1).ply", "other/ball.obj", "c.glb", "d.stl"):
        ball.export(folder / name)
    (folder / "notes.txt").write_text("no mesh")
    return folder


def results(out: Path, name: str) -> dict:
    return json.loads((out / name / "grasps.json").read_text(encoding="utf-8"))


def test_a_folder_and_a_file_of_the_same_name(call, folder, tmp_path, capsys):
    assert call(mesh=[str(folder), str(folder / "other" / "ball.obj"), str(folder / "ball.obj")]) == 0
    out = tmp_path / "out"
    assert sorted(p.name for p in out.iterdir()) == ["b ü (1)", "ball", "ball-2", "c", "d"]
    assert results(out, "ball")["mesh"] == str(folder / "ball.obj")
    assert results(out, "ball-2")["mesh"] == str(folder / "other" / "ball.obj")
    assert not capsys.readouterr().err
    assert call(mesh=str(folder / "other" / "ball.obj"), n=1) == 0
    assert len(results(out, "ball-2")["grasps"]) == 1
    assert len(results(out, "ball")["grasps"]) == 2


def test_json_says_what_was_made_with_what(call, folder, runs, tmp_path):
    call(mesh=str(folder / "c.glb"), seed=11)
    record = results(tmp_path / "out", "c")
    assert record["mesh_sha256"] == sha256(folder / "c.glb")
    for kind, name in {"CoarseNet": "coarse", "RefineNet": "fine"}.items():
        file = runs / name / "model.safetensors"
        assert record["networks"][kind] == {"file": str(file), "sha256": sha256(file)}
    assert record["config"]["seed"] == 11
    assert record["provenance"]["versions"]["torch"]
    assert [g["seed"] for g in record["grasps"]] == [11, 11]
    assert [g["index"] for g in record["grasps"]] == [0, 1]


def test_gltf_is_y_up_and_obj_z_up(call, folder, tmp_path):
    call(mesh=[str(folder / "c.glb"), str(folder / "ball.obj")])
    up = {"c": 1, "ball": 2}
    for name, axis in up.items():
        turn = read_npz(tmp_path / "out" / name / "grasps.npz")["object_transform"][:, :3, :3]
        np.testing.assert_allclose(turn[:, 2, axis], 1, atol=1e-6)


def test_scale_is_told_and_then_taken(call, tmp_path, capsys):
    ball = trimesh.creation.icosphere(2, 40)
    ball.export(tmp_path / "big.ply")
    assert call(mesh=str(tmp_path / "big.ply")) == 1
    told = capsys.readouterr().err
    assert told.startswith("error: ")
    assert told.count("\n") == 1
    assert "scale=0.001" in told
    assert call(mesh=str(tmp_path / "big.ply"), scale=0.001, format="npz") == 0
    hands = read_npz(tmp_path / "out" / "big" / "meshes" / "meshes.npz")["hand_vertices"]
    assert 50 < np.ptp(hands[0], axis=0).max() < 250  # a hand in millimetres


def test_bad_meshes_are_told_and_the_others_run(call, folder, tmp_path, capsys):
    (folder / "empty.obj").touch()
    (folder / "points.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    (folder / "nan.obj").write_text("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (folder / "flat.obj").write_text("v 0 0 0\nv 0.1 0 0\nv 0.2 0 0\nf 1 2 3\n")
    (folder / "really_png.stl").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(200))
    bad = ["empty.obj", "points.obj", "nan.obj", "flat.obj", "really_png.stl"]
    named = [*(str(folder / b) for b in bad), str(folder / "gone.ply"), str(folder / "other"), str(folder / "d.stl")]
    assert call(mesh=named) == 1
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 6
    for name in [*bad, "gone.ply"]:
        assert sum(name in sentence.split(";")[0] for sentence in told) == 1, name
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["ball", "d"]


def test_what_is_mended_is_said_and_gives_the_grasps_of_the_sound_mesh(call, tmp_path, capsys):
    assert call(mesh=[str(INPUTS / f"{name}.obj") for name in ("plain", "half_flipped", "double_sided", "utf16")]) == 0
    sound = results(tmp_path / "out", "plain")
    assert sound["remarks"] == [] and sound["grasps"][0]["max_penetration_mm"] > 0
    for name, said in (
        ("half_flipped", ["turned 6 of 12 faces, which looked the wrong way"]),
        ("double_sided", ["dropped 12 of 24 faces, which were there twice"]),
        ("utf16", []),
    ):
        found = results(tmp_path / "out", name)
        assert found["grasps"] == sound["grasps"] and found["remarks"] == said
    assert (
        "through walls (mesh: turned 6 of 12 faces, which looked the wrong way); all is in" in capsys.readouterr().out
    )


def test_an_unexpected_error_in_one_mesh_does_not_end_the_others(call, folder, tmp_path, capsys, monkeypatch):
    def broken(folder, grasps, record, *_):
        if record["name"] == "ball.obj":
            raise ValueError("of no\nuse")
        write_grasps(folder, grasps, record, *_)

    monkeypatch.setattr("grabnet.generation.run.write_grasps", broken)
    assert call(mesh=[str(folder / "ball.obj"), str(folder / "d.stl")]) == 1
    (said,) = capsys.readouterr().err.splitlines()
    assert "ball.obj: Unexpected ValueError: of no use" in said
    assert "This is a fault of grabnet's" in said
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["d"]


def test_names_that_no_disk_takes_do_not_end_the_others(call, folder, tmp_path, capsys):
    assert call(mesh=[str(folder / ("x" * 300)), str(folder / "d.stl")]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "cannot be opened" in said
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["d"]


def test_a_folder_without_meshes_is_told(call, tmp_path, capsys):
    assert call(mesh=str(tmp_path)) == 1
    assert "holds no mesh" in capsys.readouterr().err


def test_what_a_folder_holds_besides_mesh_files_is_said_by_name(call, tmp_path, capsys):
    place = tmp_path / "meshes"
    (place / "folder.obj").mkdir(parents=True)
    (place / "loop.obj").symlink_to("loop.obj")
    (place / ".hidden.obj").symlink_to("loop.obj")
    os.mkfifo(place / "pipe.ply")
    for name in ("folder", "loop", "pipe"):
        (tmp_path / "out" / name / "mine").mkdir(parents=True)
    assert call(mesh=str(place)) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3
    for name, line in zip(("folder.obj", "loop.obj", "pipe.ply"), lines, strict=True):
        assert line.startswith("error: ") and str(place / name) in line and "Unexpected" not in line


def test_a_name_of_dots_leads_nowhere_else(call, tmp_path):
    """`...obj` without its ending is the folder above: what lies there stays as it is."""
    mine = {"index.html": "mine", "grasps.json": "{}", "meshes/scan.obj": "mine", "out/notes.txt": "mine"}
    for name, text in mine.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / "in").mkdir()
    trimesh.creation.icosphere(2, 0.04).export(tmp_path / "in" / "...obj", file_type="obj")
    for _ in range(2):
        assert call(mesh=str(tmp_path / "in"), n=1, page=1, format="ply") == 0
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["mesh", "notes.txt"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["grasps.json", "in", "index.html", "meshes", "out"]
    assert {name: (tmp_path / name).read_text() for name in mine} == mine


def test_output_that_cannot_be_written_is_told(call, folder, tmp_path, capsys):
    (tmp_path / "out").write_text("a file stands in the way")
    assert call(mesh=str(folder / "ball.obj")) == 1
    told = capsys.readouterr().err
    assert "cannot be" in told
    assert told.count("\n") == 1


def test_without_refinenet(call, folder, tmp_path, capsys):
    assert call(mesh=str(folder / "ball.obj"), refine=False, betas=[1, -0.5]) == 0
    assert "RefineNet:" not in capsys.readouterr().out
    assert results(tmp_path / "out", "ball")["networks"].keys() == {"CoarseNet"}


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"n": 0}, "n is 0"),
        (
            {"n": 500_001, "candidates": 2},
            "n=500001 with candidates=2 makes 1,000,002 hands, whose vertices take",
        ),
        ({"seed": -1}, "seed is -1"),
        ({"scale": 0.0}, "scale is 0"),
        ({"scale": float("nan")}, "scale is nan"),
        ({"hand": "both"}, "right, left"),
        ({"orientation": "up"}, "upright, fixed, random"),
        ({"up": "w"}, "x, y or z"),
        ({"format": ["glb", "fbx"]}, "glb, ply, npz"),
        ({"betas": [0.0] * 11}, "betas has 11 values"),
        ({"betas": [1, "big"]}, "betas holds 'big'"),
        ({"model": "/nowhere"}, "does not exist"),
        ({"device": "tpu"}, "auto, cpu, cuda"),
        ({"contact_distance": 0.0}, "must be above 0"),
    ],
)
def test_wrong_values_are_told(call, folder, values, said):
    with pytest.raises(UserError, match=said):
        call(mesh=str(folder / "ball.obj"), **values)


def run(*arguments: str, **options) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, str(SCRIPT), *arguments], capture_output=True, text=True, **options)


def test_the_command_where_there_is_no_opengl(folder, runs, cache_dir, tmp_path):
    """A left hand, several formats, a file name full of traps, a mesh that is missing, paths relative to elsewhere."""
    hidden = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | {
        "__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent"
    }
    done = run(
        f"mesh=[b ü (1).ply,{folder / 'gone.obj'}]",
        "output=a folder",
        f"runs={runs}",
        f"cache_dir={cache_dir}",
        "n=2",
        "hand=left",
        "format=ply,npz",
        cwd=folder,
        env=hidden,
    )
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "gone.obj does not exist" in done.stderr
    assert done.stdout.count("No pictures are drawn") == 1
    out = folder / "a folder" / "b ü (1)"
    assert sorted(p.name for p in out.iterdir()) == [
        "contact",
        "contact.npz",
        "grasps.json",
        "grasps.npz",
        "index.html",
        "meshes",
    ]
    names = ["hand_000.ply", "hand_001.ply", "meshes.npz", "object.ply"]
    assert sorted(p.name for p in (out / "meshes").iterdir()) == names
    assert read_npz(out / "grasps.npz")["side"] == "left"
    assert len(list((out / "contact").iterdir())) == 4
    assert sorted(p.name for p in folder.iterdir() if p.is_dir()) == ["a folder", "other"]


@pytest.mark.parametrize(
    ("argument", "said"),
    [("see=1", "Unknown key 'see'"), ("hand=both", "hand is 'both'; it can be right, left")],
)
def test_mistakes_on_the_command_line(argument, said):
    done = run("mesh=x.obj", argument)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
