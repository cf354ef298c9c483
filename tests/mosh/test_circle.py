"""The whole way round: recordings, captures of them, recordings solved of these, contact, training frames."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hydra.utils import instantiate

from grabnet.body.whole import OPEN_BODY
from grabnet.cli.entry import compose
from grabnet.data.sequences import load_below, read_sequence, write_sequence
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, save_mesh
from grabnet.io.files import sha256
from grabnet.mosh.captures import read_capture
from grabnet.mosh.judging import run as judge
from grabnet.mosh.layouts import read_object_layouts
from grabnet.mosh.run import run as solve
from grabnet.mosh.synthesising import run as synthesise
from grabnet.preprocess.run import preprocess
from tests.mosh.conftest import LAYOUTS, Actor
from tests.mosh.recorded import RATE, record

FRAMES = 12
NAMES = ("s8/ball_lift_1", "s8/can_lift_1", "s9/ring_pass_1")
SOLVER = ("stage_one.iterations=6", "stage_one.annealing=[1.0]", "stage_one.frames=6")


def configured(name: str, *values: str):
    return instantiate(compose(name, values), _convert_="all")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("recorded")
    record(root, {name: Actor(FRAMES, seed) for seed, name in enumerate(NAMES)})
    return root


def captures(recorded: Path, out: Path, *values: str):
    return configured("mosh/synthesise", f"root={recorded}", f"out={out}", "workers=1", "quiet=true", *values)


@pytest.fixture(scope="module")
def captured(recorded, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("captured")
    assert synthesise(captures(recorded, out)) == 0
    return out


def solved(captured: Path, out: Path, name: str) -> int:
    """Solve a subject's captures with what lies beside them."""
    tools = captured / "tools"
    values = [
        f"capture={captured / 'captures' / name}", f"name={name}", "gender=male", f"out={out}", "workers=1",
        f"subject={tools / f'subject_meshes/male/{name}.ply'}", f"objects={captured / 'objects.yaml'}",
        f"meshes={tools / 'object_meshes/contact_meshes'}", "pictures=false", "quiet=true", *SOLVER, "object_smooth=0",
    ]  # fmt: skip
    return solve(configured("mosh/mosh", *values))


def truth_of(captured: Path, name: str) -> dict[str, np.ndarray]:
    return dict(np.load(captured / "truth" / f"{name}.npz"))


def test_captures_are_read_back_as_the_truth_has_them(captured):
    for name in NAMES:
        truth, found = truth_of(captured, name), read_capture(captured / "captures" / f"{name}.c3d")
        who, _, take = name.partition("/")
        assert found.prefixes == (who, take.partition("_")[0]) and found.rate == RATE
        assert found.labels == tuple(truth["labels"]) and len(found.labels) == 99 + 8
        off = (found.positions - truth["positions"])[found.seen]
        assert off.std() == pytest.approx(0.001, rel=0.1) and np.abs(off).max() < 0.006
        assert not found.seen[truth["hidden"]].any(), "what no camera sees is missing"
        others = (~found.seen & ~truth["hidden"]).sum(1)
        assert others.max() <= 5 and others.any()


def test_the_truth_is_where_posed_bodies_and_objects_have_it(captured, actor):
    for name in NAMES:
        truth, sequence = truth_of(captured, name), read_sequence(captured / "grab" / f"{name}.npz")
        rest = torch.tensor(load_below(captured, sequence.body.vtemp, mend=False).vertices)
        skin = actor.body(sequence.body.parameters(), rest).vertices.double().numpy()
        corners = np.einsum("tmkc,mk->tmc", skin[:, truth["corners"]], truth["weights"])
        distance = np.linalg.norm(truth["positions"][:, :99] - corners, axis=-1)
        np.testing.assert_allclose(distance, np.tile(truth["distance"], (FRAMES, 1)), atol=1e-5)
        own = read_object_layouts(captured / "objects.yaml")[sequence.obj_name].positions
        expected = sequence.object.to_world(torch.as_tensor(own).float()).numpy()
        np.testing.assert_allclose(truth["positions"][:, 99:], expected, atol=1e-6)


def test_markers_stay_on_a_subject_and_sit_elsewhere_on_another(captured):
    first, second, other = (truth_of(captured, name) for name in NAMES)
    assert (first["corners"] == second["corners"]).all() and (first["corners"] != other["corners"]).any()
    assert (first["positions"] != second["positions"]).any()


def test_captures_are_made_once_and_the_same_again(recorded, captured, tmp_path, capsys):
    path = captured / "captures" / f"{NAMES[0]}.c3d"
    before = path.stat().st_mtime_ns
    assert synthesise(captures(recorded, captured)) == 0 and path.stat().st_mtime_ns == before
    said = capsys.readouterr().out
    assert f"{NAMES[0]}: {FRAMES} frames" in said and "grabnet mosh capture=" in said
    assert synthesise(captures(recorded, tmp_path, f"recordings=[{NAMES[0]}]")) == 0
    assert (tmp_path / "captures" / f"{NAMES[0]}.c3d").read_bytes() == path.read_bytes()
    with pytest.raises(UserError, match=r"was started with seed=0, now it is 1: delete"):
        synthesise(captures(recorded, captured, "seed=1"))


def test_flaws_and_moving_faces_can_be_asked_for(recorded, tmp_path, capsys):
    values = ["flaws.swapped=0.1", "flaws.ghosts=0.05", "flaws.noise=0", "occlusion=false", "face=true"]
    assert synthesise(captures(recorded, tmp_path, f"recordings=[{NAMES[0]}]", *values)) == 0
    truth, found = truth_of(tmp_path, NAMES[0]), read_capture(tmp_path / "captures" / f"{NAMES[0]}.c3d")
    far = np.linalg.norm(found.positions - truth["positions"], axis=-1)[found.seen] > 1e-4
    assert 0.08 < far.mean() < 0.17 and not truth["hidden"].any() and "0.0 % hidden" in capsys.readouterr().out
    moved = read_sequence(tmp_path / "grab" / f"{NAMES[0]}.npz").body.jaw_pose
    assert (
        np.ptp(moved[:, 0]) > 0.001
        and (moved != read_sequence(recorded / "grab" / f"{NAMES[0]}.npz").body.jaw_pose).any()
    )


def test_a_recording_that_cannot_be_captured_leaves_the_others(recorded, tmp_path, capsys):
    root = tmp_path / "recorded"
    shutil.copytree(recorded, root)
    (root / "tools/object_meshes/contact_meshes/can.ply").unlink()
    assert synthesise(captures(root, tmp_path / "out", "occlusion=false")) == 1
    assert "error: s8/can_lift_1: Mesh of the object" in capsys.readouterr().err
    assert (tmp_path / "out/captures/s9/ring_pass_1.c3d").exists()


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        (["root=/no/where"], r"Folder of recordings \(root\) /no/where does not exist"),
        (["recordings=[s8/x]"], "has no recording 's8/x'; it has s8/ball_lift_1"),
        (["flaws.noise=-1"], "noise is -1; it must be at least 0"),
        (["rig.views=60"], "rig.views is 60; there are 54 cameras"),
        (["rig.heights=[]"], "rig.heights is .*; it must not be empty"),
        (["layout=nowhere.yaml"], "Layout nowhere.yaml does not exist"),
    ],
)
def test_what_cannot_start_is_refused(recorded, tmp_path, values, sentence):
    with pytest.raises(Exception, match=sentence):
        synthesise(captures(recorded, tmp_path / "out", *values))
    with pytest.raises(Exception, match="whose recordings would be replaced"):
        captures(recorded, recorded)


def test_the_circle(captured, tmp_path, cache_dir, capsys):
    for name in ("s8", "s9"):  # two subjects in one data set
        assert solved(captured, tmp_path / "solved", name) == 0
    values = [
        "data=open", f"data.root={tmp_path / 'solved'}", "data.contact=recompute", "workers=1", "pictures=false",
        f"data.contact_output={tmp_path / 'contact'}", f"output={tmp_path / 'frames'}", f"cache_dir={cache_dir}",
        "filter.min_finger_vertices=3", "filter.min_lift=0.001", "filter.left_hand_free=false",
    ]  # fmt: skip
    assert not preprocess(configured("preprocess/preprocess", *values))
    both = [f"truth={captured}", f"solved={tmp_path / 'solved'}", f"contact={tmp_path / 'contact'}", "every=1"]
    capsys.readouterr()
    assert judge(configured("mosh/judge", *both, f"output={tmp_path / 'judged.json'}")) == 0
    assert "parts F1" in capsys.readouterr().out
    judged = json.loads((tmp_path / "judged.json").read_text())
    assert set(judged["recordings"]) == set(NAMES) and not judged["failed"]
    whole = judged["all"]
    assert whole["part_f1"] > 0.85 and whole["part_agreement"] > 0.85, whole
    assert whole["vertices"] < 4 and whole["places"] < 4 and whole["object"] < 3 and whole["turn"] < 5, whole
    card = json.loads((tmp_path / "frames/card.json").read_text())
    assert set(card["frames"]["by_subject"]) == {"s8", "s9"} and card["frames"]["in_all"] > FRAMES


def test_what_cannot_be_compared_is_refused(captured, tmp_path, capsys):
    with pytest.raises(UserError, match="have no recording of the same name"):
        judge(configured("mosh/judge", f"truth={captured}", f"solved={tmp_path}", f"output={tmp_path / 'a.json'}"))
    values = [f"truth={captured}", f"solved={captured}", f"contact={tmp_path}", f"output={tmp_path / 'a.json'}"]
    assert judge(configured("mosh/judge", *values)) == 1
    assert "error: s8/ball_lift_1: Contact found" in capsys.readouterr().err


@pytest.fixture
def few(captured, tmp_path) -> Path:
    """A folder of the truth with one recording, and the same as if solved beside it, in `solved`."""
    for folder in ("truth", "solved"):
        shutil.copytree(captured / "tools", tmp_path / folder / "tools")
        shutil.copytree(captured / "grab/s9", tmp_path / folder / "grab/s9")
    return tmp_path


def judged(few: Path, *values: str) -> int:
    both = [f"truth={few / 'truth'}", f"solved={few / 'solved'}", f"output={few / 'judged.json'}", "quiet=true"]
    return judge(configured("mosh/judge", *both, *values))


def resaved(path: Path, **values) -> None:
    write_sequence(path, replace(read_sequence(path), **values))


def test_recordings_that_are_not_solved_and_objects_that_are_not_followed_are_said(few, capsys):
    assert judged(few) == 0 and "not followed" not in capsys.readouterr().out
    shutil.copytree(few / "truth/grab/s9", few / "truth/grab/s8")
    resaved(few / "solved/grab/s9/ring_pass_1.npz", obj_name="none")
    assert judged(few) == 1
    said = capsys.readouterr()
    assert "1 of 2 are not solved: s8/ring_pass_1" in said.err
    assert "In 1 of 1 the object is not followed: s9/ring_pass_1" in said.out
    assert json.loads((few / "judged.json").read_text())["not_solved"] == ["s8/ring_pass_1"]


def test_bodies_that_cannot_be_compared_are_named(few, capsys):
    save_mesh(few / "solved/tools/subject_meshes/male/s9.ply", Mesh(np.eye(3), np.array([[0, 1, 2]])))
    assert judged(few) == 1
    assert "solved/tools/subject_meshes/male/s9.ply has 3 vertices, the body model 13,718" in capsys.readouterr().err
    resaved(few / "solved/grab/s9/ring_pass_1.npz", gender="female")
    assert judged(few, f"models={few}") == 1
    assert f"is male in {few / 'truth'} and female in {few / 'solved'}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("stored", "sentence"),
    [
        ({"latent": np.zeros((1, 3)), "labels": ["ODD"]}, "places ODD, which .* lacks: they are of two layouts"),
        ({"latent": np.zeros((1, 3))}, "has no labels, as of an older version: solve the captures again"),
    ],
)
def test_placements_of_other_layouts_and_versions_are_refused(captured, few, capsys, stored, sentence):
    shutil.copytree(captured / "truth", few / "truth/truth")
    (few / "solved/mosh").mkdir()
    np.savez(few / "solved/mosh/s9.placement.npz", **stored)
    assert judged(few) == 1
    assert re.search(sentence, capsys.readouterr().err)


def test_what_is_made_of_another_recording_or_in_an_earlier_run(recorded, tmp_path, capsys):
    """Captures follow their recordings; objects of earlier runs stay; the printed command can be typed."""
    root, out, layout = tmp_path / "the root", tmp_path / "the out", tmp_path / "own.yaml"
    shutil.copytree(recorded, root)
    shutil.copyfile(LAYOUTS / "open_body_plug_in_gait.yaml", layout)
    ball, ring = NAMES[0], NAMES[2]

    def make(name: str) -> bytes:
        assert not synthesise(captures(root, out, f"recordings=[{name}]", "occlusion=false", f"layout={layout}"))
        return (out / "captures" / f"{name}.c3d").read_bytes()

    first = make(ball)
    line = capsys.readouterr().out.splitlines()[-1]
    assert f"capture={out}/captures/s8" in shlex.split(line) and f"layout={layout}" in shlex.split(line)
    make(ring)
    assert set(read_object_layouts(out / "objects.yaml")) == {"ball", "ring"}
    path = root / f"grab/{ball}.npz"
    sequence = read_sequence(path)
    resaved(path, object=replace(sequence.object, transl=sequence.object.transl + np.float32(0.1)))
    assert make(ball) != first
    recipe = json.loads((out / "recipe.json").read_text())
    assert recipe["body_sha256"] == {"neutral": sha256(OPEN_BODY / "SMPLX_NEUTRAL.npz")}
