"""Recordings of another layout in one file: filtered and written like GRAB's."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import pytest
import torch

from grabnet.body.hand import HandModel
from grabnet.data.frames import FramesStore
from grabnet.data.splits import Split
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, load_mesh, save_mesh
from grabnet.io.files import sha256
from grabnet.preprocess.filtering import FrameFilter
from grabnet.preprocess.grasp_track import GraspTrack
from grabnet.preprocess.recordings import Recording, RecordingSource
from grabnet.preprocess.run import PreprocessConfig, preprocess
from tests.preprocess.tiny_grab import N_FRAMES, RESTING, ball, lifting

NAMES = ["s1/ball_lift_1", "s2/ball_use_1"]
FILTER = FrameFilter(
    right_hand=True, left_hand_free=True, min_lift=0.005, thumb=True, min_other_fingers=1, min_finger_vertices=1,
    every=1, height="frame0", mirror_left=False,
)  # fmt: skip


class ToyRecording(Recording):
    """Of a right hand and no other; thumb and index finger touch from the moment that the ball is taken."""

    def __init__(self, folder, name):
        made = lifting(name)
        mesh = load_mesh(folder / "ball.ply")
        labels = torch.zeros(N_FRAMES, len(mesh.vertices), dtype=torch.uint8).numpy()
        labels[RESTING:, 0], labels[RESTING:, 1] = 55, 43
        hand = replace(made.rhand, vtemp="anybody")
        self.right = GraspTrack(name, made.sbj_id, "ball", made.motion_intent, hand, made.object, labels)
        self.centroid = mesh.centroid
        self.inputs = {f"{name}.txt": sha256(folder / f"{name}.txt")}


class ToyRecordings(RecordingSource):
    def __init__(self, folder):
        self._folder = folder
        solid = ball()
        save_mesh(folder / "ball.ply", Mesh(solid.vertices, solid.faces))
        for name in NAMES:
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / f"{name}.txt").write_text(name)

    @property
    def folder(self):
        return self._folder

    def names(self):
        return NAMES

    def objects(self):
        return {"ball": self._folder / "ball.ply"}

    def hand(self):
        return HandModel.open()

    def recipe(self):
        return {"toy": 1}

    def read(self, name):
        return ToyRecording(self._folder, name)

    def rest(self, template):
        assert template == "anybody"
        return self.hand().v_template


@pytest.fixture
def config(tmp_path, cache_dir):
    (tmp_path / "toy").mkdir()
    return PreprocessConfig(
        data=ToyRecordings(tmp_path / "toy"), filter=FILTER, split=Split("subject", [], ["s2"]),
        output=str(tmp_path / "data"), contact_distance=0.0045, pictures=False, cache_dir=str(cache_dir),
        backend="joblib", workers=1, dask_address=None, threads=None, max_deaths=3,
    )  # fmt: skip


def test_frames_of_other_recordings_are_filtered_and_written(config):
    assert preprocess(config) == []
    store = FramesStore.load(config.store)
    n = N_FRAMES - RESTING - 1  # frames in which the ball is 5 mm up
    assert store.sequences == NAMES and len(store.frames) == 2 * n
    frames, hand = store.frames, HandModel.open()
    vertices = hand(frames.hand(), store.v_template[frames.subject]).vertices
    made = lifting(NAMES[0])
    kept = slice(RESTING + 1, None)
    expected = hand(made.rhand.parameters(kept)).vertices - torch.tensor(made.object.transl[kept, None])
    torch.testing.assert_close(vertices[:n], expected, atol=1e-5, rtol=0)
    card = json.loads((config.root / "card.json").read_text())
    assert card["frames"]["by_split"] == {"test": n, "train": n} and card["split"] == asdict(config.split)
    assert card["recipe"]["toy"] == 1 and card["inputs_sha256"].keys() == {f"{name}.txt" for name in NAMES}
    assert "- toy: 1" in (config.root / "card.md").read_text()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"mirror_left": True}, "has no left hand: set filter.mirror_left=false"),
        ({"height": "table"}, "has no table: set filter.height=frame0"),
    ],
)
def test_what_the_recordings_do_not_hold_fails_in_a_sentence(config, change, sentence):
    failures = preprocess(replace(config, filter=replace(FILTER, **change)))
    assert [outcome.name for outcome in failures] == NAMES
    assert all(sentence in outcome.failure for outcome in failures)


def test_changed_inputs_are_refused(config):
    preprocess(config)
    (config.data.folder / f"{NAMES[1]}.txt").write_text("changed")
    with pytest.raises(UserError, match=r"was made when .*ball_use_1\.txt was another file"):
        preprocess(config)
