"""GRAB's sequence files: what is written comes back, the format's traps, and each fault in one sentence."""

from __future__ import annotations

import os
from dataclasses import fields, is_dataclass

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from grabnet.body.hand import HandModel
from grabnet.data.sequences import load_below, read_sequence, write_sequence
from grabnet.errors import UserError
from grabnet.io.npz import read_npz
from tests.data.grab import random_sequence

T = 7


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "grab" / "s1" / "mug_pass_1.npz"
    write_sequence(path, random_sequence(T))
    return path


def rewrite(path, change):
    """Change what is stored, as another writer might have it."""
    stored = read_npz(path)
    change(stored)
    np.savez(path, **{k: np.array(v, dtype=object) if isinstance(v, dict) else v for k, v in stored.items()})


def assert_equal(ours, expected):
    for f in fields(expected):
        a, b = getattr(ours, f.name), getattr(expected, f.name)
        if is_dataclass(b):
            assert_equal(a, b)
        else:
            np.testing.assert_array_equal(a, b, err_msg=f.name)


def test_what_is_written_comes_back(path):
    assert_equal(read_sequence(path), random_sequence(T))
    assert len(read_sequence(path)) == T


def test_files_are_laid_out_as_grabs_are(path):
    """As any user of GRAB reads them."""
    with np.load(path, allow_pickle=True) as stored:
        assert str(stored["obj_name"]) == "mug" and int(stored["n_frames"]) == T and int(stored["n_comps"]) == 24
        rhand, thing, contact = (stored[name].item() for name in ("rhand", "object", "contact"))
        assert rhand["params"]["fullpose"].shape == (T, 45) and rhand["params"]["hand_pose"].shape == (T, 24)
        assert rhand["vtemp"] == "tools/subject_meshes/female/s1_rhand.ply"
        assert thing["object_mesh"] == "tools/object_meshes/contact_meshes/mug.ply"
        assert stored["body"].item()["params"]["fullpose"].shape == (T, 165)
        assert contact["object"].shape == (T, 40) and stored["table"].item()["table_mesh"].endswith("table.ply")


def test_the_same_sequence_is_the_same_file(path, tmp_path):
    write_sequence(tmp_path / "again.npz", read_sequence(path))
    assert (tmp_path / "again.npz").read_bytes() == path.read_bytes()


def test_objects_turn_as_row_vectors(path):
    track = read_sequence(path).object
    points = np.random.default_rng(1).normal(size=(6, 3))
    matrices = Rotation.from_rotvec(track.global_orient).as_matrix()
    expected = np.stack([points @ r + t for r, t in zip(matrices, track.transl, strict=True)])
    ours = track.to_world(torch.tensor(points, dtype=torch.float32))
    np.testing.assert_allclose(ours, expected, atol=1e-6)
    some = track.to_world(torch.tensor(points, dtype=torch.float32), np.array([5, 2]))
    np.testing.assert_allclose(some, expected[[5, 2]], atol=1e-6)
    np.testing.assert_allclose(track.to_local(ours), np.broadcast_to(points, (T, 6, 3)), atol=1e-6)


def test_hands_are_posed_by_fullpose(path):
    """Not by the components, which would be off by centimetres here."""
    track = read_sequence(path).rhand
    parameters = track.parameters(slice(2, 4))
    np.testing.assert_allclose(
        parameters.hand_pose, Rotation.from_rotvec(track.fullpose[2:4].reshape(-1, 3)).as_matrix().reshape(2, 15, 3, 3),
        atol=1e-6,
    )  # fmt: skip
    assert HandModel.open()(parameters).vertices.shape == (2, 778, 3)


def test_bodies_are_posed_by_fullpose(path):
    track = read_sequence(path).body
    rotations = track.parameters().rotations
    expected = Rotation.from_rotvec(track.fullpose.reshape(-1, 3)).as_matrix().reshape(T, 55, 3, 3)
    np.testing.assert_allclose(rotations, expected, atol=1e-6)


@pytest.mark.parametrize("key", ["gender", "rhand", "object", "contact", "n_frames"])
def test_missing_keys_are_named(path, key):
    rewrite(path, lambda stored: stored.pop(key))
    with pytest.raises(UserError, match=rf"mug_pass_1\.npz lacks {key} in the file"):
        read_sequence(path)


def test_missing_parameters_are_named(path):
    rewrite(path, lambda stored: (stored["rhand"]["params"].pop("fullpose"), stored["lhand"].pop("vtemp")))
    with pytest.raises(UserError, match="lacks fullpose in params of rhand"):
        read_sequence(path)
    rewrite(path, lambda stored: stored["rhand"]["params"].update(fullpose=np.zeros((T, 45))))
    with pytest.raises(UserError, match="lacks vtemp in lhand"):
        read_sequence(path)


@pytest.mark.parametrize(
    ("track", "key", "shape", "sentence"),
    [
        ("rhand", "fullpose", (T, 48), r"rhand fullpose is float64 of shape \(7, 48\), expected numbers \(7, 45\)"),
        ("lhand", "hand_pose", (T, 12), r"lhand hand_pose .* expected numbers \(7, 24\)"),
        ("body", "expression", (T,), r"body expression .* of shape \(7,\)"),
        ("object", "transl", (T - 1, 3), "object transl has 6 frames, n_frames says 7"),
    ],
)
def test_wrong_shapes_are_told(path, track, key, shape, sentence):
    rewrite(path, lambda stored: stored[track]["params"].update({key: np.zeros(shape)}))
    with pytest.raises(UserError, match=sentence):
        read_sequence(path)


def test_values_that_are_not_finite_are_told_with_their_frame(path):
    def change(stored):
        stored["body"]["params"]["fullpose"][[3, 5], 80] = np.nan

    rewrite(path, change)
    with pytest.raises(UserError, match="body fullpose is not finite in 2 of 7 frames, first in frame 3"):
        read_sequence(path)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"object": np.full((T, 4), 56)}, "contact object has labels 56 … 56; parts are numbered 0 … 55"),
        ({"object": np.full((T, 4), -1)}, "has labels -1"),
        ({"body": np.zeros((T + 1, 9), int)}, "contact body has 8 frames, n_frames says 7"),
        ({"body": np.zeros((T, 9))}, "contact body is float64"),
    ],
)
def test_wrong_labels_are_told(path, change, sentence):
    rewrite(path, lambda stored: stored["contact"].update(change))
    with pytest.raises(UserError, match=sentence):
        read_sequence(path)


def test_unknown_objects_are_told(path):
    assert read_sequence(path, ["cup", "mug"]).obj_name == "mug"
    with pytest.raises(UserError, match="shows 'mug', an object without a mesh; there are cup, teapot"):
        read_sequence(path, ["teapot", "cup"])


@pytest.mark.parametrize(
    "outside", ["../../secret.ply", "/etc/passwd", "tools/../../x.ply", "C:\\x.ply", "..\\x.ply", ""]
)
def test_templates_outside_the_root_are_refused(path, outside):
    rewrite(path, lambda stored: stored["rhand"].update(vtemp=outside))
    with pytest.raises(UserError, match=r"rhand vtemp is '.*', which leads out of GRAB's root"):
        read_sequence(path)


def test_templates_are_loaded_from_below_the_root_only(tmp_path):
    ball = trimesh.creation.icosphere(1)
    (tmp_path / "root/tools").mkdir(parents=True)
    for file in ("root/tools/s1.ply", "secret.ply"):
        ball.export(tmp_path / file)
    root = tmp_path / "root"
    np.testing.assert_allclose(load_below(root, "tools/s1.ply").vertices, ball.vertices, atol=1e-7)
    (root / "tools/link.ply").symlink_to(tmp_path / "secret.ply")
    for outside in ("tools/link.ply", "../secret.ply", str(tmp_path / "secret.ply")):
        with pytest.raises(UserError, match="leads out of"):
            load_below(root, outside)


class Bomb:
    def __reduce__(self):
        return os.mkdir, (os.environ["BOMB"],)


def test_pickled_functions_are_refused(path, tmp_path, monkeypatch):
    monkeypatch.setenv("BOMB", str(tmp_path / "crater"))
    rewrite(path, lambda stored: stored["contact"].update(extra=Bomb()))
    with pytest.raises(UserError, match=r"mug_pass_1\.npz \(contact\.npy\) holds a pickled posix\.mkdir"):
        read_sequence(path)
    assert not (tmp_path / "crater").exists()


@pytest.mark.parametrize(("key", "value"), [("n_frames", 0), ("n_comps", np.zeros(2)), ("framerate", np.nan)])
def test_wrong_numbers_are_told(path, key, value):
    rewrite(path, lambda stored: stored.update({key: value}))
    with pytest.raises(UserError, match=f"{key} is .*expected a positive number"):
        read_sequence(path)
