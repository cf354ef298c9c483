"""Archives of arrays: what numpy writes comes back, objects only as plain data, damage and bombs in a sentence."""

from __future__ import annotations

import os
import zipfile

import numpy as np
import pytest

from grabnet.errors import UserError
from grabnet.io.npz import npz_rows, read_npz

ARRAYS = {
    "float": np.linspace(0, 1, 24).reshape(2, 3, 4),
    "fortran": np.asfortranarray(np.arange(6).reshape(2, 3)),
    "text": np.array("mug"),
    "empty": np.zeros((0, 3)),
    "big endian": np.arange(3, dtype=">i4"),
}


class Bomb:
    def __reduce__(self):
        return os.mkdir, (os.environ["BOMB"],)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_come_back(tmp_path, save):
    save(tmp_path / "a.npz", **ARRAYS)
    read = read_npz(tmp_path / "a.npz")
    assert read.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(read[name], array)
        assert read[name].dtype == array.dtype and read[name].flags.writeable


def test_pickled_dicts_come_as_dicts(tmp_path):
    body = {"params": {"transl": np.ones((5, 3))}, "vtemp": "tools/subject_meshes/male/s1.ply"}
    np.savez(tmp_path / "a.npz", body=np.array(body, dtype=object), names=np.array(["a", None], dtype=object))
    read = read_npz(tmp_path / "a.npz")
    assert read["body"]["vtemp"] == body["vtemp"]
    np.testing.assert_array_equal(read["body"]["params"]["transl"], np.ones((5, 3)))
    assert read["names"].tolist() == ["a", None]


def test_pickled_functions_are_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("BOMB", str(tmp_path / "crater"))
    np.savez(tmp_path / "a.npz", fine=np.ones(3), body=np.array(Bomb(), dtype=object))
    with pytest.raises(UserError, match=r"a\.npz \(body\.npy\) holds a pickled posix\.mkdir"):
        read_npz(tmp_path / "a.npz")
    assert not (tmp_path / "crater").exists()


def test_bombs_are_refused_before_they_unpack(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", zeros=np.zeros(10**6))
    assert (tmp_path / "a.npz").stat().st_size < 10**5
    with pytest.raises(UserError, match=r"unpacks to 8,000,\d+ bytes; at most 1,000,000"):
        read_npz(tmp_path / "a.npz", max_bytes=10**6)


def test_a_header_that_promises_more_than_there_is(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.zeros(10))
    with zipfile.ZipFile(tmp_path / "a.npz") as archive:
        content = archive.read("x.npy")
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as archive:
        archive.writestr("x.npy", content.replace(b"'shape': (10,)", b"'shape': (99,)"))
    with pytest.raises(UserError, match="not a readable"):
        read_npz(tmp_path / "b.npz")


@pytest.mark.parametrize("keep", [0, 10, 500, -30])
def test_truncated_archives_are_told(tmp_path, keep):
    np.savez(tmp_path / "a.npz", **ARRAYS)
    (tmp_path / "a.npz").write_bytes((tmp_path / "a.npz").read_bytes()[:keep])
    with pytest.raises(UserError, match=r"a\.npz is not a readable \.npz file"):
        read_npz(tmp_path / "a.npz")


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_rows_come_in_order(tmp_path, save):
    array = np.random.default_rng(0).normal(size=(10, 3, 2)).astype(np.float32)
    save(tmp_path / "a.npz", x=array, other=np.ones(3))
    parts = list(npz_rows(tmp_path / "a.npz", "x", 4))
    assert [len(part) for part in parts] == [4, 4, 2]
    np.testing.assert_array_equal(np.concatenate(parts), array)


def test_rows_of_what_has_none_are_refused(tmp_path):
    np.savez(tmp_path / "a.npz", one=np.array(1.0), objects=np.array([{}], dtype=object))
    for name, sentence in {"one": "no plain array", "objects": "no plain array", "two": "has no array two"}.items():
        with pytest.raises(UserError, match=sentence):
            next(npz_rows(tmp_path / "a.npz", name, 2))
