"""From recordings to a data set as the command makes it: what is in it, and that only its inputs decide that."""

from __future__ import annotations

import csv
import json
import os
import random
import shutil
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from filelock import FileLock
from hydra.utils import instantiate

from grabnet.body.hand import HandModel
from grabnet.cli.entry import compose
from grabnet.contact.rules import ContactRules
from grabnet.data.datamodule import GraspDataModule
from grabnet.data.frames import FramesStore, shard_names, write_shard
from grabnet.data.objects import OBJECT_MESHES, ObjectSet
from grabnet.data.sequences import read_sequence, write_sequence
from grabnet.data.splits import Split
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, read_mesh, save_mesh
from grabnet.io.locks import LOCK
from grabnet.io.npz import read_npz
from grabnet.preprocess.filtering import Waterfall
from grabnet.preprocess.pictures import draw_waterfall
from grabnet.preprocess.recordings import GrabRecordings
from grabnet.preprocess.run import run
from grabnet.training.run import train
from tests.data.test_frames import shard_values
from tests.faults import DiesPublishing
from tests.preprocess.tiny_grab import (
    N_FRAMES,
    RESTING,
    SEQUENCES,
    data_set,
    files_of,
    grip,
    lifting,
    make,
    overrides,
)  # fmt: skip
from tests.processes import ROOT, finish
from tests.tiny import tiny_overrides

SCRIPT = "scripts/preprocess.py"
SPLIT = {"split": Split("object", ["apple"], ["mug"])}
N_LIFTED = N_FRAMES - RESTING - 1  # frames in which the ball is 5 mm up


@pytest.fixture
def own_grab(grab, tmp_path):
    """A copy to spoil."""
    shutil.copytree(grab[0], tmp_path / "grab")
    return tmp_path / "grab", grab[1]


def test_frames_show_what_was_recorded(made):
    store, hand = FramesStore.load(made / "frames"), HandModel.open()
    assert store.sequences == sorted(SEQUENCES) and store.subjects == ["s1", "s2"]
    frames = store.frames
    assert len(frames) == N_LIFTED * (len(SEQUENCES) - 1)
    vertices = hand(frames.hand(), store.v_template[frames.subject]).vertices
    for k in range(len(frames)):
        recorded, number = lifting(store.sequences[frames.sequence[k]]), frames.frame[k].item()
        expected = hand(recorded.rhand.parameters(slice(number, number + 1))).vertices[0].numpy()
        np.testing.assert_allclose(vertices[k], expected - recorded.object.transl[number], atol=1e-5)
        assert number > RESTING


def test_the_likelihood_of_contact_is_that_of_training_frames(made, grab, cache_dir):
    """As training finds it; of a ball it is known without any mesh."""
    store, hand = FramesStore.load(made / "frames"), HandModel.open()
    frames = store.frames.select(torch.tensor([n == "ball" for n in store.objects])[store.frames.object])
    vertices = hand(frames.hand(), store.v_template[frames.subject]).vertices
    expected = (vertices.norm(dim=-1) < grip()[1] + 0.0045).float().mean(0)
    data = GraspDataModule(hand, str(made), **SPLIT, object_points=64, cache_dir=str(cache_dir))
    data.setup()
    assert expected.max() == 1 and ((data.contact - expected).abs() > 1e-6).float().mean() < 0.01  # facets lie inside


def test_the_card_counts_and_the_waterfall_adds_up(made):
    card = json.loads((made / "card.json").read_text())
    assert card["sequences"] == {"read": 7, "mirrored": 0, "without_frames": 1, "failed": []}
    frames = card["frames"]
    assert frames["in_all"] == 6 * N_LIFTED
    assert frames["by_split"] == {"test": N_LIFTED, "train": 4 * N_LIFTED, "val": N_LIFTED}
    assert frames["by_intent"] == {"lift": 3 * N_LIFTED, "pass": N_LIFTED, "use": 2 * N_LIFTED}
    assert frames["by_action"] == {"lift": 3 * N_LIFTED, "look": 0, "pass": N_LIFTED, "use": 2 * N_LIFTED}
    assert frames["by_subject"] == {"s1": 3 * N_LIFTED, "s2": 3 * N_LIFTED}
    shares = card["touching_in_frames"]["all frames"]
    assert (shares["thumb"], shares["index"], shares["ring"]) == (1, 1, 0)
    assert len(card["inputs_sha256"]) == 7 + 3 + 2 and card["recipe"]["filter"]["min_lift"] == 0.005
    with (made / "waterfall.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert sum(int(row["in all"]) for row in rows) == 7 * N_FRAMES
    assert sum(int(row["min_other_fingers"]) for row in rows) == frames["in_all"]
    used = [(r["split"], r["right_hand"], r["min_lift"]) for r in rows if r["intent"] == "use"]
    # In one of the two recordings for training the ball is looked at, where it lies.
    held = str(N_FRAMES - RESTING)
    assert used == [("test", held, str(N_LIFTED)), ("train", str(2 * (N_FRAMES - RESTING)), str(N_LIFTED))]
    text = (made / "card.md").read_text()
    assert "30 frames of 7 recordings, of which 1 gave none." in text and "| all frames |30|100 %|100 %|0 %" in text


def test_pictures_are_drawn(grab, tmp_path, cache_dir):
    make(grab, tmp_path, cache_dir, "pictures=true")
    for name in ("waterfall.png", "contact.png"):
        assert (tmp_path / name).stat().st_size > 10_000


def test_training_takes_it(made, tmp_path, cache_dir):
    values = [o for o in tiny_overrides(made, tmp_path, cache_dir) if "split" not in o]
    more = ("data.batch_size=8", "trainer.max_epochs=1", "callbacks.grasps=null")
    metrics = train(compose("train", [*values, *more, "data.split.val=[apple]", "data.split.test=[mug]"]))
    assert metrics["test/train/v2v"] > 0


def test_three_kills_leave_no_trace(grab, made, tmp_path, cache_dir):
    output, log = tmp_path / "data", tmp_path / "log.txt"
    arguments = overrides(*grab, output, cache_dir)
    done = 0
    for _ in range(3):
        n = random.randint(1, 3)
        fault = DiesPublishing("*/shards/*.safetensors", n)
        assert finish(arguments, log, fault, SCRIPT) == -signal.SIGKILL, log.read_text()
        done += n - 1
        assert len(shard_names(output / "frames")) == done
        assert list(output.glob("frames/shards/*/.*.safetensors"))  # half of what it was about to publish
    assert finish(arguments, log, script=SCRIPT) == 0, log.read_text()
    assert data_set(output) == data_set(made)
    assert json.loads((output / "run.json").read_text())["recordings"] == 7 - done


def spoil(path, change):
    stored = read_npz(path)
    change(stored)
    np.savez(path, **{k: np.array(v, dtype=object) if isinstance(v, dict) else v for k, v in stored.items()})


def test_bad_recordings_are_told_and_the_rest_goes_on(own_grab, made, tmp_path, cache_dir):
    spoilt = {
        "s1/ball_bad_1": lambda stored: stored["rhand"]["params"]["transl"].__setitem__((3, 1), np.nan),
        "s1/ball_bad_2": lambda stored: stored.pop("table"),
        "s1/ball_bad_3": lambda stored: stored.update(obj_name="teapot"),
        "s2/ball_bad_4": lambda stored: stored["contact"].update(object=np.zeros((N_FRAMES, 99), int)),
        "s2/ball_bad_5": lambda stored: stored["rhand"].update(vtemp="tools/nobody.ply"),
        "s2/ball_bad_7": lambda stored: stored.update(motion_intent="\ud800"),
        "s2/ball_bad_8": lambda stored: stored.update(motion_intent="\x1b[31mlift"),
        "s2/ball_bad_9": lambda stored: stored["rhand"].update(vtemp="tools/subject_meshes/female/s2_rhand.ply"),
    }
    for name, change in spoilt.items():
        path = own_grab[0] / "grab" / f"{name}.npz"
        shutil.copyfile(own_grab[0] / "grab/s1/ball_lift_1.npz", path)
        spoil(path, change)
    (own_grab[0] / "grab/s2/ball_bad_6.npz").write_bytes(b"no zip file")
    for name in ("._ball_lift_1.npz", "ball_lift_1 (1).npz", "ball_lift_1 copy.npz", "ball_lift_1 2.npz"):
        shutil.copyfile(own_grab[0] / "grab/s1/ball_lift_1.npz", own_grab[0] / "grab/s1" / name)
    log = tmp_path / "log.txt"
    assert finish(overrides(*own_grab, tmp_path / "data", cache_dir), log, script=SCRIPT) == 1
    assert "error: 9 recordings failed; why is in" in log.read_text() and "Traceback" not in log.read_text()
    failures = json.loads((tmp_path / "data/failures.json").read_text())
    for (name, reason), said in zip(
        failures.items(),
        ("rhand transl is not finite in 1 of 10 frames, first in frame 3", "lacks table", "shows 'teapot', an object",
         "labels 99 vertices of an object that has 2562", "nobody.ply does not exist", "not a readable .npz",
         "text with what is no character", r"motion_intent is '\x1b[31mlift'", "others of its subject from"),
        strict=True,
    ):  # fmt: skip
        assert name.split("_")[1] == "bad" and said in reason and "\n" not in reason
    for name, content in files_of(made / "frames").items():
        if name != "store.json":
            assert (tmp_path / "data/frames" / name).read_bytes() == content
    assert (tmp_path / "data/frames/store.json").read_bytes() == (made / "frames/store.json").read_bytes()


def test_names_that_look_like_formulas_are_names(tmp_path):
    waterfall = Waterfall()
    waterfall.add("train", r"$\frac$", "$_{$", {"in all": 3, "touching": 2})
    draw_waterfall(waterfall, tmp_path / "waterfall.png")
    assert (tmp_path / "waterfall.png").exists()


def test_labels_found_anew_are_compared_with_those_in_the_files(own_grab, made, tmp_path, cache_dir):
    """The files' are what we find; in one of them every third label is made another part's."""
    path = own_grab[0] / "grab/s1/ball_lift_1.npz"
    sequence = read_sequence(path)
    labels = sequence.contact.object.copy()
    labels[:, ::3][labels[:, ::3] == 55] = 54
    write_sequence(path, replace(sequence, contact=replace(sequence.contact, object=labels)))
    assert make(own_grab, tmp_path / "data", cache_dir, "data.contact=recompute") == {}
    frames, expected = (FramesStore.load(folder / "frames").frames for folder in (tmp_path / "data", made))
    assert torch.equal(frames.transl, expected.transl) and torch.equal(frames.frame, expected.frame)
    found = np.concatenate([read_sequence(p).contact.object for p in sorted(own_grab[0].glob("grab/*/*.npz"))])
    changed = (labels != sequence.contact.object).sum()
    thumb = (found == 55).sum() + changed
    agreement = json.loads((tmp_path / "data/agreement.json").read_text())
    assert agreement["object"].pop("54") == 0
    assert agreement["object"].pop("55") == pytest.approx(1 - changed / thumb) and 0 < changed < thumb / 2
    assert set(agreement["object"].values()) == {1.0} and set(agreement["body"].values()) == {1.0}


def test_contact_found_anew_is_written_and_survives_a_kill(grab, tmp_path, cache_dir):
    """The command dies as it publishes a recording's contact, goes on, and ends in the bytes of an undisturbed run."""
    log = tmp_path / "log.txt"

    def arguments(name):
        where = f"data.contact_output={tmp_path / name / 'contact (ours)'}"
        ours = ("data.contact=recompute", where, "data.contact_frame=8", "contact=paper")
        return overrides(*grab, tmp_path / name, cache_dir, *ours)

    fault = DiesPublishing("*/contact (ours)/grab/*/*.npz", 3)
    assert finish(arguments("killed"), log, fault, SCRIPT) == -signal.SIGKILL, log.read_text()
    assert len(shard_names(tmp_path / "killed/frames")) == 2
    for name in ("killed", "whole"):
        assert finish(arguments(name), log, script=SCRIPT) == 0, log.read_text()
    killed, whole = (files_of(tmp_path / name / "contact (ours)") for name in ("killed", "whole"))
    assert killed == whole
    assert len(whole) == 1 + len(SEQUENCES) * 4
    recipe = json.loads(whole["recipe.json"])
    assert recipe["contact_rules"] == {"measured_to": "vertices", "part_by": "bone"} and recipe["frame"] == 8
    for name in SEQUENCES:
        recorded, found = (
            read_sequence(root / f"grab/{name}.npz") for root in (grab[0], tmp_path / "whole/contact (ours)")
        )
        np.testing.assert_array_equal(found.rhand.fullpose, recorded.rhand.fullpose)
        held = (recorded.contact.object > 0).any(1)
        np.testing.assert_array_equal((found.contact.object > 0).any(1), held)
    # What is missing of a finished data set is made.
    (tmp_path / "whole/contact (ours)/grab/s1/ball_lift_1.npz").unlink()
    assert finish(arguments("whole"), log, script=SCRIPT) == 0, log.read_text()
    assert files_of(tmp_path / "whole/contact (ours)") == killed


def test_contact_that_would_replace_recordings_is_refused(grab, tmp_path, cache_dir):
    before = files_of(grab[0])
    with pytest.raises(UserError, match=r"data\.contact_output is data\.root, .* whose recordings would be replaced"):
        make(grab, tmp_path, cache_dir, "data.contact=recompute", f"data.contact_output={grab[0]}/.")
    assert files_of(grab[0]) == before


def test_height_above_the_table_finds_the_same_lifts(grab, made, tmp_path, cache_dir):
    assert make(grab, tmp_path, cache_dir, "filter.height=table") == {}
    frames, expected = (FramesStore.load(folder / "frames").frames for folder in (tmp_path, made))
    assert torch.equal(frames.frame, expected.frame) and torch.equal(frames.transl, expected.transl)


def test_what_the_left_hand_holds_arrives_as_if_the_right_one_held_it(own_grab, made, tmp_path, cache_dir):
    """A recording is mirrored in its file; the pipeline mirrors it back."""
    flip, name = np.array([-1, 1, 1], np.float32), "s1/ball_lift_1"
    right = read_sequence(own_grab[0] / f"grab/{name}.npz")
    opposite = np.arange(56)
    opposite[26:41], opposite[41:56] = np.arange(41, 56), np.arange(26, 41)

    def mirrored(track):
        turned = {"global_orient": -flip * track.global_orient, "transl": flip * track.transl}
        if hasattr(track, "fullpose"):
            turned["fullpose"] = (track.fullpose.reshape(-1, 15, 3) * -flip).reshape(-1, 45)
        return replace(track, **turned)

    left = replace(
        right, obj_name="ball", object=mirrored(right.object),
        lhand=replace(mirrored(right.rhand), vtemp=right.lhand.vtemp),
        contact=replace(right.contact, object=opposite[right.contact.object]),
    )  # fmt: skip
    shutil.rmtree(own_grab[0] / "grab")
    write_sequence(own_grab[0] / f"grab/{name}.npz", left)
    assert make(own_grab, tmp_path / "data", cache_dir, "filter.mirror_left=true") == {}
    store, original = FramesStore.load(tmp_path / "data/frames"), FramesStore.load(made / "frames")
    assert store.sequences == [name, f"{name}_mirrored"] and store.objects == ["ball", "ball_mirrored"]
    assert store.subjects == ["s1", "s1_mirrored"]
    expected = original.frames.select(original.frames.sequence == original.sequences.index(name))
    assert len(store.frames) == len(expected) == N_LIFTED  # the right hand itself does nothing
    for value in ("global_orient", "hand_pose", "transl", "object_orient", "frame"):
        torch.testing.assert_close(getattr(store.frames, value), getattr(expected, value), atol=1e-6, rtol=0)
    torch.testing.assert_close(store.v_template[1], original.v_template[0], atol=1e-6, rtol=0)
    # What is held out stays held out in the mirror.
    data = GraspDataModule(HandModel.open(), str(tmp_path / "data"), Split("object", ["ball"], ["mug"]))
    assert len(data._members("val")) == N_LIFTED and not len(data._members("train"))


def test_a_store_is_continued_by_code_whose_comments_have_changed(grab, made, tmp_path, cache_dir):
    """By the same command from a copy of the repository, in which every module ends in another comment."""
    for name in ("grabnet", "scripts", "hydra_plugins"):
        shutil.copytree(ROOT / name, tmp_path / "copy" / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("assets", "configs"):
        (tmp_path / "copy" / name).symlink_to(ROOT / name)
    for path in (tmp_path / "copy/grabnet").rglob("*.py"):
        path.write_text(path.read_text() + "# Another comment.\n")
    output = tmp_path / "data"
    shutil.copytree(made, output)
    (output / "frames/store.json").unlink()
    (output / "frames/shards/s1/ball_lift_1.safetensors").unlink()
    command = [sys.executable, tmp_path / "copy" / SCRIPT, *overrides(*grab, output, cache_dir)]
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "copy")}
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert data_set(output) == data_set(made)
    assert json.loads((output / "run.json").read_text())["recordings"] == 1


def test_a_store_of_another_format_is_refused(made, grab, tmp_path, cache_dir, monkeypatch):
    shutil.copytree(made, tmp_path / "data")
    monkeypatch.setattr("grabnet.preprocess.run.FORMAT", 0)
    with pytest.raises(UserError, match=r"frames was started with format=\d, now it is 0: delete"):
        make(grab, tmp_path / "data", cache_dir)


@pytest.mark.parametrize("changed", ["settings", "recording", "removed", "foreign", "at work"])
def test_a_store_of_something_else_is_not_gone_on_with(changed, own_grab, tmp_path, cache_dir):
    output, more, sentence = tmp_path / "data", [], ""
    (own_grab[0] / "grab/s1/apple_lift_1.npz").rename(own_grab[0] / "apple.npz")
    shutil.rmtree(own_grab[0] / "grab/s2")
    if changed == "foreign":
        write_shard(output / "frames", "s1/mug_lift_1", "s1", "mug", shard_values(3, 0))
        sentence = "holds frames without a record of what they were made from"
    else:
        make(own_grab, output, cache_dir)
    path = own_grab[0] / "grab/s1/ball_pass_1.npz"
    if changed == "settings":
        more, sentence = ["filter.min_lift=0.01"], r"was started with filter\.min_lift=0\.005, now it is 0\.01: delete"
    if changed == "recording":
        write_sequence(path, lifting("s1/ball_pass_1"))
        sentence = r"ball_pass_1\.safetensors was made when .*ball_pass_1\.npz was another file: delete the shard"
    if changed == "removed":
        path.unlink()
        sentence = r"ball_pass_1\.safetensors is of a recording that .* does not hold"
    if changed == "at work":
        lock = FileLock(output / "frames" / LOCK)
        lock.acquire()
        sentence = "Another run is at work on"
    before = files_of(output)
    with pytest.raises(UserError, match=sentence):
        make(own_grab, output, cache_dir, *more)
    assert files_of(output) == before | {f"frames/{LOCK}": b""}
    if changed == "at work":
        lock.release()


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        (["data=opne"], "There is no data 'opne'; data can be grab, open."),
        (["data=grab"], r"data\.models must be given"),
        (["backend=dask"], "belong together"),
        (["dask_address=tcp://10.0.0.1:8786"], "belong together"),
        (["workers=0"], "workers is 0; it must be at least 1"),
        (["data.contact=guess"], r"data\.contact is 'guess'; it can be stored, recompute\."),
        (["contact.part_by=joint"], r"contact\.part_by is 'joint'; it can be skinning, bone\."),
        (["contact=exact"], r"There is no contact 'exact'; contact can be paper, surface\."),
        (["data.contact_output=x"], r"give data\.contact=recompute, too"),
        (["data.contact_frame=3"], r"give data\.contact_output, too"),
        (
            ["data.contact=recompute", "data.contact_output=x", "data.contact_frame=3", "filter.every=2"],
            r"data\.contact_frame is 3, which has no labels: give a multiple of 2",
        ),
        (["data.contact_frame=-1"], r"data\.contact_frame is -1; it must be at least 0"),
        (["filter.height=floor"], r"filter\.height is 'floor'; it can be frame0, table"),
        (["filter.every=0"], r"filter\.every is 0"),
        (["filter.min_lift=-0.01"], r"filter\.min_lift is -0\.01; it must be at least 0"),
        (["filter.min_other_fingers=5"], r"filter\.min_other_fingers is 5; there are 4"),
        (["fitler.every=2"], "Unknown key 'fitler.every'; did you mean filter.every"),
        (["data.root=/nowhere"], r"/nowhere holds no recordings .*: make them with python scripts/build_open\.py"),
    ],
)
def test_mistakes_are_told_at_once(values, sentence, tmp_path):
    with pytest.raises(Exception) as caught:  # Hydra wraps what constructors raise
        run(instantiate(compose("preprocess/preprocess", [f"output={tmp_path}", *values]), _convert_="all"))
    mistake = caught.value if isinstance(caught.value, UserError) else caught.value.__cause__
    assert isinstance(mistake, UserError)
    with pytest.raises(UserError, match=sentence):
        raise mistake


def test_missing_models_are_named_where_they_are_needed(grab, tmp_path, cache_dir):
    (tmp_path / "models").mkdir()
    shutil.copyfile(grab[1] / "MANO_RIGHT.npz", tmp_path / "models/MANO_RIGHT.npz")
    here = (grab[0], tmp_path / "models")
    with pytest.raises(UserError, match="holds neither SMPLX_FEMALE nor smplx/SMPLX_FEMALE"):
        make(here, tmp_path / "data", cache_dir, "data.contact=recompute")
    assert make(here, tmp_path / "data", cache_dir) == {}


def test_objects_whose_faces_disagree_are_mended_with_their_vertices_in_order(made, own_grab, tmp_path, cache_dir):
    """Labels found, and distances in training, are those of the sound mesh."""
    name = next(name for name in SEQUENCES if "/ball" in name)
    recordings = GrabRecordings(*map(str, own_grab), "recompute", 0.0045, 3, ContactRules())
    sound = recordings.read(name).right.labels
    shutil.copytree(made, tmp_path / "made")
    for file in (root / OBJECT_MESHES / "ball.ply" for root in (own_grab[0], tmp_path / "made")):
        mesh = read_mesh(file, weld=False)
        turned = mesh.faces[:, ::-1]
        save_mesh(file, Mesh(mesh.vertices, np.where(mesh.faces[:, :1] % 2, mesh.faces, turned)))
    with pytest.warns(UserWarning, match=r"ball\.ply was mended: turned [\d,]+ of 5,120 faces"):
        found = recordings.read(name).right.labels
    assert found.any()
    np.testing.assert_array_equal(found, sound)
    with pytest.warns(UserWarning, match=r"ball\.ply was mended: turned [\d,]+ of 5,120 faces"):
        objects = ObjectSet.load(tmp_path / "made" / OBJECT_MESHES, ["ball"], cache_dir=cache_dir)
    radii = torch.tensor([0.5, 0.9, 1.1, 2.0]) * grip()[1]
    points = torch.nn.functional.normalize(torch.tensor([[1.0, 2, 3]])) * radii[:, None]
    expected = radii - grip()[1]
    torch.testing.assert_close(objects.atlas(points[None], torch.tensor([0]))[0], expected, atol=1e-3, rtol=0)
