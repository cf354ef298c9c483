"""The command, from files of markers to recordings, and all that it refuses."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from hydra.errors import InstantiationException
from hydra.utils import instantiate

from grabnet.body.hand import HandModel
from grabnet.cli.entry import CONFIGS
from grabnet.data.sequences import read_sequence
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, save_mesh
from grabnet.mosh.layouts import spread_markers, write_object_layouts
from grabnet.mosh.run import MoshConfig, run
from grabnet.mosh.synthesis import Flaws, spoilt
from tests.mosh.conftest import LAYOUTS, Actor, write_csv

ROOT = Path(__file__).parents[2]
FAST = ("quiet=true", "pictures=false", "workers=1", "stage_one.iterations=2",
        "stage_one.annealing=[1.0]", "stage_two.sweeps=2",
        "stage_one.frames=6")  # fmt: skip


def mosh(*arguments: str) -> subprocess.CompletedProcess:
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, "-m", "grabnet", "mosh", *arguments]
    return subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True)


def config(*overrides: str) -> MoshConfig:
    """The command's config, in this process."""
    with initialize_config_dir(str(CONFIGS / "mosh"), version_base="1.3"):
        return instantiate(compose("mosh", [*overrides]), _convert_="all")


@pytest.fixture(scope="module")
def lab(tmp_path_factory, actor: Actor) -> Path:
    """A folder with captures of the actor, who moves a box about, their template and the box's mesh and markers."""
    folder = tmp_path_factory.mktemp("lab")
    corners = 0.05 * np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 2)], np.float32)
    faces = [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2],
             [2, 4, 6], [1, 3, 5], [3, 7, 5]]  # fmt: skip
    box = Mesh(corners, np.array(faces)[:, ::-1])
    (folder / "meshes").mkdir()
    save_mesh(folder / "meshes/box.ply", box)
    save_mesh(folder / "s9.ply", Mesh(actor.body.v_template.numpy(), actor.body.faces.numpy()))
    layout = spread_markers("box", box)
    write_object_layouts(folder / "objects.yaml", [layout])
    labels = [f"s9:{label}" for label in actor.layout.labels] + [f"box:{label}" for label in layout.labels]
    shift = np.linspace(0, 0.3, len(actor.markers))[:, None, None] * [0, 0, 1.0] + [0.4, 0.1, 0.8]
    both = np.concatenate([actor.markers, layout.positions + shift], 1)
    (folder / "captures").mkdir()
    for k in (1, 2):
        seen = spoilt(both, 120, Flaws(), k)
        write_csv(folder / f"captures/box_lift_{k}.csv", labels, seen[:: 1 if k == 1 else 3])
    return folder


def arguments(lab: Path, out: Path, *more: str) -> list[str]:
    return [
        f"capture={lab / 'captures'}", f"subject={lab / 's9.ply'}", f"objects={lab / 'objects.yaml'}",
        f"meshes={lab / 'meshes'}", f"out={out}", "name=s9", *FAST, *more,
    ]  # fmt: skip


def test_captures_become_recordings_and_are_not_solved_twice(lab, tmp_path, actor):
    ended = mosh(*arguments(lab, tmp_path / "out"))
    assert ended.returncode == 0 and not ended.stderr, ended.stderr
    assert "s9/box_lift_1: 24 frames" in ended.stdout and "frames per second of one core" in ended.stdout
    path = tmp_path / "out/grab/s9/box_lift_1.npz"
    sequence = read_sequence(path, ["box"])
    assert sequence.obj_name == "box" and sequence.motion_intent == "lift" and sequence.framerate == pytest.approx(24)
    found = actor.body(sequence.body.parameters()).vertices
    assert 1e3 * (found - actor.vertices).norm(dim=-1).mean() < 6
    assert np.ptp(sequence.object.transl[:, 2]) == pytest.approx(0.3, abs=0.01)
    # The hands are where the body has them.
    template = actor.body.v_template
    wrist = actor.body(sequence.body.parameters(), template).joints[:, 21]
    hand = HandModel.open()
    joints = hand(sequence.rhand.parameters(), hand.v_template.expand(24, -1, -1)).joints[:, 0]
    assert (joints - wrist).norm(dim=1).max() < 1e-5
    report = json.loads((tmp_path / "out/mosh/s9/box_lift_1.json").read_text())
    assert report["body"]["residual_mm_by_type"]["finger"]["median"] < 5 and report["object"]["solved"] == 24
    assert report["body"]["frames"] == 24

    before = path.stat().st_mtime_ns
    assert run(config(*arguments(lab, tmp_path / "out"))) == 0
    assert path.stat().st_mtime_ns == before
    with pytest.raises(UserError, match=r"was started with stage_two.noise=0.0018, now it is 0.003"):
        run(config(*arguments(lab, tmp_path / "out", "stage_two.noise=0.003")))
    placement = tmp_path / "out/mosh/s9.placement.yaml"
    placement.write_text(placement.read_text().replace("LKNE:", "RKNE:", 1))
    with pytest.raises(UserError, match=r"placement.yaml is not as it was when .*placement.npz was written"):
        run(config(*arguments(lab, tmp_path / "out")))


def test_a_report_says_how_many_labels_were_put_right(lab, tmp_path, actor):
    """The knees' labels change places for four frames."""
    seen = spoilt(actor.markers, 120, Flaws(noise=0.0, dropped=0), 1)
    knees = [actor.layout.labels.index(label) for label in ("LKNE", "RKNE")]
    seen[5:9, knees] = seen[5:9, knees[::-1]]
    write_csv(tmp_path / "walk_1.csv", [f"s9:{label}" for label in actor.layout.labels], seen)
    given = [f"capture={tmp_path / 'walk_1.csv'}", f"subject={lab / 's9.ply'}", f"out={tmp_path / 'out'}", "name=s9"]
    assert run(config(*given, *FAST)) == 0
    report = json.loads((tmp_path / "out/mosh/s9/walk_1.json").read_text())
    assert any(note.startswith("8 marker positions in 4 frames fit another label") for note in report["notes"])
    assert report["body"]["residual_mm_by_marker"]["LKNE"]["outliers"] == pytest.approx(4 / 24, abs=0.01)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("subject=nowhere.ply",), "Template of the subject nowhere.ply does not exist"),
        (("layout=nowhere.yaml",), "Layout nowhere.yaml does not exist"),
        (("capture=/no/where",), "Capture /no/where does not exist"),
        (("reading.prefix=s3",), "No marker has the prefix 's3'; the labels' prefixes are s9, box"),
        (("reading.unit=mm",), "which no capture does: give the right reading.unit=mm, cm or m"),
        (("reading.up=w",), "up is 'w'; it can be x, y, z"),
        (("stage_one.frames=0",), "frames is 0; it must be at least 1"),
        (("stage_one.betas=3",), "gives the subject's shape: stage_one.betas must be 0, not 3"),
        (("subject=null", "stage_one.betas=15"), "stage_one.betas is 15; the body model has 10 betas"),
        (("name=a/b",), "name is 'a/b'; it must be usable as a folder's name"),
        (("objects=null",), "meshes= is given without objects="),
        (("models=/no/where",), "Folder of models (models) /no/where does not exist"),
        (("gender=x",), "gender is 'x'; it can be male, female, neutral"),
        (("workers=0",), "workers is 0; it must be at least 1"),
    ],
)
def test_what_cannot_start_is_refused_in_one_sentence(lab, tmp_path, change, sentence):
    with pytest.raises((UserError, InstantiationException), match=re.escape(sentence)):
        run(config(*arguments(lab, tmp_path / "out", *change)))


def test_refusals_end_the_command():
    ended = mosh("capture=nowhere.c3d")
    assert ended.returncode == 2 and ended.stderr.startswith("error: Capture nowhere.c3d does not exist")


def test_a_capture_that_fails_leaves_the_others(lab, tmp_path, capsys):
    captures = tmp_path / "captures"
    captures.mkdir()
    (captures / "box_lift_1.csv").write_text((lab / "captures/box_lift_2.csv").read_text())
    lines = (lab / "captures/box_lift_2.csv").read_text().splitlines()
    (captures / "empty_lift_1.csv").write_text("\n".join([lines[0], *(f"{t},{t / 24:.6f}" for t in range(4))]))
    command = arguments(lab, tmp_path / "out", f"capture={captures}", "stage_one_captures=1")
    assert run(config(*command)) == 1
    said = capsys.readouterr().err
    assert "error: s9/empty_lift_1:" in said and "are missing in all 4 frames" in said
    assert (tmp_path / "out/grab/s9/box_lift_1.npz").exists()
    assert "empty_lift_1" in (tmp_path / "out/mosh/s9.failures.json").read_text()


def test_a_damaged_capture_is_no_matter_to_stage_one(lab, tmp_path, capsys):
    captures = tmp_path / "captures"
    captures.mkdir()
    (captures / "a_damaged.c3d").write_bytes(b"x" * 600)
    (captures / "box_lift_1.csv").write_text((lab / "captures/box_lift_2.csv").read_text())
    assert run(config(*arguments(lab, tmp_path / "out", f"capture={captures}"))) == 1
    assert capsys.readouterr().err.splitlines() == [
        f"error: s9/a_damaged: {captures}/a_damaged.c3d is no c3d file: it lacks the format's first two bytes."
    ]


def test_whose_template_and_whose_markers_is_asked(lab, tmp_path, actor):
    big = tmp_path / "mm.ply"
    save_mesh(big, Mesh(1000 * actor.body.v_template.numpy(), actor.body.faces.numpy()))
    with pytest.raises(UserError, match="times as large as the body model: it must be in metres"):
        run(config(*arguments(lab, tmp_path / "out", f"subject={big}")))
    two = [f"{who}:{label}" for who in ("a", "b") for label in actor.layout.labels]
    write_csv(tmp_path / "two.csv", two, np.concatenate([actor.markers, actor.markers + np.array([1, 0, 0])], 1)[:4])
    command = arguments(lab, tmp_path / "out", f"capture={tmp_path / 'two.csv'}", "objects=null", "meshes=null")
    with pytest.raises(UserError, match="the labels of a, b all fit the layout: say whom to solve by reading"):
        run(config(*command))
    assert run(config(*command, "reading.prefix=b")) == 0, "a run that could not start claims no folder"
    assert read_sequence(tmp_path / "out/grab/s9/two.npz").body.transl[0, 0] > 0.9


def test_a_body_that_lies_down_is_asked_about(lab, tmp_path, actor, capsys):
    write_csv(tmp_path / "turned.csv", actor.layout.labels, actor.markers[:4])  # the actor's y is up
    here = [f"capture={tmp_path / 'turned.csv'}", "objects=null", "meshes=null"]
    assert run(config(*arguments(lab, tmp_path / "lying", *here))) == 0
    assert "lies along the file's axis y in most frames: if that is up, give reading.up" in capsys.readouterr().out
    assert run(config(*arguments(lab, tmp_path / "standing", *here, "reading.up=y"))) == 0
    assert "reading.up" not in capsys.readouterr().out


def test_limbs_without_markers_are_named(lab, tmp_path, actor, capsys):
    owners = [actor.body.weights[marker.vertices[0]].argmax() for marker in actor.layout.markers]
    kept = [joint not in (4, 7, 10) for joint in owners]  # of the left leg from the knee on
    labels = [label for label, keep in zip(actor.layout.labels, kept, strict=True) if keep]
    write_csv(tmp_path / "one_leg.csv", labels, actor.markers[:4, kept])
    here = [f"capture={tmp_path / 'one_leg.csv'}", "objects=null", "meshes=null"]
    assert run(config(*arguments(lab, tmp_path / "out", *here))) == 0
    assert "No marker sits beyond left_knee: how the body is bent there is guessed." in capsys.readouterr().out


def test_a_killed_run_goes_on_where_it_was(lab, tmp_path):
    captures = tmp_path / "captures"
    captures.mkdir()
    for k in range(1, 9):
        (captures / f"box_lift_{k}.csv").write_text((lab / "captures/box_lift_1.csv").read_text())
    command = arguments(lab, tmp_path / "out", f"capture={captures}", "stage_one_captures=2")
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    running = subprocess.Popen([sys.executable, "-m", "grabnet", "mosh", *command], cwd=ROOT, env=env)
    reports, recordings = tmp_path / "out/mosh/s9", tmp_path / "out/grab/s9"
    while running.poll() is None and not [*reports.glob("[!.]*.json")]:
        time.sleep(0.005)
    running.kill()
    running.wait()
    done = {path.stem: (recordings / f"{path.stem}.npz").stat().st_mtime_ns for path in reports.glob("[!.]*.json")}
    assert 1 <= len(done) < 8
    assert run(config(*command)) == 0
    assert len([*reports.glob("*.json")]) == len([*recordings.glob("*.npz")]) == 8
    assert not [path for path in (tmp_path / "out").rglob("*") if path.suffix in (".tally", ".tmp")]
    for name, when in done.items():
        assert (recordings / f"{name}.npz").stat().st_mtime_ns == when


def test_pictures_and_a_folder_of_models(lab, tmp_path, actor):
    from PIL import Image

    from grabnet.body.hand import OPEN_HANDS
    from grabnet.body.whole import OPEN_BODY
    from grabnet.visual.pictures import can_render

    models = tmp_path / "models"
    (models / "smplx").mkdir(parents=True)
    (models / "mano").mkdir()
    (models / "smplx/SMPLX_FEMALE.npz").write_bytes((OPEN_BODY / "SMPLX_NEUTRAL.npz").read_bytes())
    for side in ("LEFT", "RIGHT"):
        (models / f"mano/MANO_{side}.npz").write_bytes((OPEN_HANDS / f"MANO_{side}.npz").read_bytes())
    capture = f"capture={lab / 'captures/box_lift_2.csv'}"
    more = [capture, f"models={models}", "gender=female", "pictures=true"]
    assert run(config(*arguments(lab, tmp_path / "out", *more))) == 0
    sequence = read_sequence(tmp_path / "out/grab/s9/box_lift_2.npz")
    assert sequence.gender == "female" and (tmp_path / "out" / sequence.body.vtemp).exists()
    assert run(config(*arguments(lab, tmp_path / "open", capture, "gender=female"))) == 0
    other = read_sequence(tmp_path / "open/grab/s9/box_lift_2.npz")
    np.testing.assert_array_equal(sequence.body.fullpose, other.body.fullpose)
    plot = tmp_path / "out/mosh/s9/box_lift_2.png"
    assert Image.open(plot).size[0] == 1200
    if can_render() is None:
        film = Image.open(plot.with_suffix(".webp"))
        assert film.n_frames == len(sequence) / 2 and film.size == (460, 560)


def test_layouts_are_shipped():
    assert {path.name for path in LAYOUTS.glob("*.yaml")} == {
        "open_body_grab99.yaml", "open_body_plug_in_gait.yaml", "open_objects.yaml",
    }  # fmt: skip
