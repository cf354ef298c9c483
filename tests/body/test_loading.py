"""Model files that are not what they should be: one sentence each, and nothing run."""

from __future__ import annotations

import os
import pickle

import numpy as np
import pytest
import scipy.sparse

from grabnet.body.hand import HandModel
from grabnet.body.loading import HAND_SHAPES, check_shapes, read_model
from grabnet.errors import UserError


def save(folder, arrays, name="MANO_RIGHT.npz"):
    np.savez(folder / name, **arrays)
    return folder / name


def one_sentence(error, *parts):
    text = str(error.value)
    assert all(part in text for part in parts), text
    assert text.endswith(".") and "\n" not in text


def test_reads_every_array_as_stored(tmp_path, random_mano):
    model = read_model(save(tmp_path, random_mano), HAND_SHAPES, "MANO")
    for name in ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "hands_mean", "hands_components"):
        np.testing.assert_array_equal(model[name], random_mano[name].astype(np.float32))
    np.testing.assert_array_equal(model["faces"], random_mano["f"])
    assert model["parents"].tolist() == [-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14]


@pytest.mark.parametrize(("name", "right"), [("MANO_RIGHT.npz", True), ("MANO_LEFT.npz", False)])
def test_side_is_read_off_the_name(tmp_path, random_mano, name, right):
    assert HandModel(save(tmp_path, random_mano, name)).is_right is right


def test_a_pickled_model_is_the_same_model(tmp_path, random_mano):
    """As published: a pickle, with the joint regressor as a sparse matrix."""
    path = tmp_path / "MANO_RIGHT.pkl"
    pickled = random_mano | {"J_regressor": scipy.sparse.csc_matrix(random_mano["J_regressor"]), "bs_type": "lrotmin"}
    path.write_bytes(pickle.dumps(pickled, 2))
    expected = read_model(save(tmp_path, random_mano), HAND_SHAPES, "MANO")
    for name, value in read_model(path, HAND_SHAPES, "MANO").items():
        np.testing.assert_array_equal(value, expected[name])


def test_a_pickle_of_something_else_is_no_model(tmp_path):
    path = tmp_path / "MANO_RIGHT.pkl"
    path.write_bytes(pickle.dumps([1, 2]))
    with pytest.raises(UserError) as error:
        HandModel(path)
    one_sentence(error, str(path), "list")


def test_parents_behind_their_children_are_refused(tmp_path, random_mano):
    tree = random_mano["kintree_table"].copy()
    tree[0, 3] = 7
    with pytest.raises(UserError) as error:
        HandModel(save(tmp_path, random_mano | {"kintree_table": tree}))
    one_sentence(error, "kintree_table")


@pytest.mark.parametrize("missing", [["posedirs"], ["f", "weights"]])
def test_missing_arrays_are_named(tmp_path, random_mano, missing):
    path = save(tmp_path, {k: v for k, v in random_mano.items() if k not in missing})
    with pytest.raises(UserError) as error:
        HandModel(path)
    one_sentence(error, str(path), *missing)


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("v_template", (778, 2)),
        ("v_template", (777, 3)),
        ("posedirs", (778, 3, 207)),
        ("J_regressor", (24, 778)),
        ("weights", (778, 24)),
        ("hands_mean", (45, 1)),
        ("hands_components", (45,)),
        ("f", (1538, 4)),
    ],
)
def test_wrong_shapes_are_told(tmp_path, random_mano, name, shape):
    path = save(tmp_path, random_mano | {name: np.zeros(shape)})
    with pytest.raises(UserError) as error:
        HandModel(path)
    one_sentence(error, str(path), "shape", "expected")


def test_faces_beyond_the_vertices_are_refused(tmp_path, random_mano):
    faces = random_mano["f"].copy()
    faces[3, 1] = 778
    with pytest.raises(UserError) as error:
        HandModel(save(tmp_path, random_mano | {"f": faces}))
    one_sentence(error, "faces", "777")


def test_no_faces_are_refused(tmp_path, random_mano):
    with pytest.raises(UserError) as error:
        HandModel(save(tmp_path, random_mano | {"f": np.zeros((0, 3), np.uint32)}))
    one_sentence(error, "faces")


@pytest.mark.parametrize("name", ["v_template", "weights", "J_regressor"])
def test_numbers_that_are_not_finite_are_refused(tmp_path, random_mano, name):
    array = random_mano[name].copy()
    array[5, 1] = np.nan
    with pytest.raises(UserError) as error:
        HandModel(save(tmp_path, random_mano | {name: array}))
    one_sentence(error, name)


def test_arrays_of_text_are_refused(tmp_path, random_mano):
    with pytest.raises(UserError) as error:
        HandModel(save(tmp_path, random_mano | {"hands_mean": np.full(45, "zero")}))
    one_sentence(error, "hands_mean")


class Bomb:
    def __reduce__(self):
        return os.mkdir, (os.environ["BOMB"],)


@pytest.mark.parametrize("kind", ["npz", "pkl"])
def test_pickles_are_refused_and_never_run(tmp_path, random_mano, kind, monkeypatch):
    crater = tmp_path / "crater"
    monkeypatch.setenv("BOMB", str(crater))
    path = tmp_path / f"MANO_RIGHT.{kind}"
    if kind == "npz":
        np.savez(path, **random_mano | {"bs_style": np.array([Bomb()], dtype=object)})
    else:
        path.write_bytes(pickle.dumps(random_mano | {"bs_style": Bomb()}))
    with pytest.raises(UserError) as error:
        HandModel(path)
    one_sentence(error, str(path), "pickled posix.mkdir")
    assert not crater.exists()


@pytest.mark.parametrize("keep", [0, 10, 5000, -30])
def test_truncated_files_are_told(tmp_path, random_mano, keep):
    path = save(tmp_path, random_mano)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(UserError) as error:
        HandModel(path)
    one_sentence(error, str(path), "not a readable")


@pytest.mark.parametrize("compress", [True, False])
@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.7, 0.999])
def test_damaged_bytes_are_told(tmp_path, random_mano, share, compress):
    path = tmp_path / "MANO_RIGHT.npz"
    (np.savez_compressed if compress else np.savez)(path, **random_mano)
    content = bytearray(path.read_bytes())
    start = int(share * (len(content) - 100))
    content[start : start + 100] = bytes(100)
    path.write_bytes(content)
    with pytest.raises(UserError) as error:
        HandModel(path)
    one_sentence(error, str(path))


def test_one_array_alone_is_no_model(tmp_path):
    path = tmp_path / "MANO_RIGHT.npy"
    np.save(path, np.zeros(3))
    with pytest.raises(UserError) as error:
        HandModel(path)
    one_sentence(error, str(path))


def test_a_missing_file_lists_what_lies_beside_it(tmp_path, random_mano):
    save(tmp_path, random_mano, "MANO_LEFT.npz")
    with pytest.raises(UserError) as error:
        HandModel(tmp_path / "MANO_RIGHT.npz")
    one_sentence(error, "MANO_RIGHT.npz", "MANO_LEFT.npz")


def test_a_folder_is_no_model(tmp_path):
    with pytest.raises(UserError) as error:
        HandModel(tmp_path)
    one_sentence(error, str(tmp_path))


def test_equal_letters_stand_for_equal_sizes():
    shapes = {"a": ("V", 3), "b": (16, "V")}
    check_shapes("file", {"a": np.zeros((5, 3)), "b": np.zeros((16, 5))}, shapes)
    with pytest.raises(UserError, match=r"b has shape \(16, 6\), expected \(16, 5\)"):
        check_shapes("file", {"a": np.zeros((5, 3)), "b": np.zeros((16, 6))}, shapes)
