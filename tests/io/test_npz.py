"""Archives of arrays: what numpy writes comes back, objects only as plain data, damage and bombs in a sentence."""

from __future__ import annotations

import os
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest

from grabnet.errors import UserError
from grabnet.io.npz import npz_names, npz_rows, read_npy, read_npz

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
        assert read[name].dtype == array.dtype.newbyteorder("=") and read[name].flags.writeable


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


def _npy(descr: str, shape: str, order: str = "False", content: bytes = bytes(8)) -> bytes:
    text = f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n".encode("latin1")
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + content


HEADERS = {
    "a product that overflows": _npy("'<f8'", "(4294967296, 4294967296)"),
    "a product of zero after overflow": _npy("'<f8'", "(1000000000000, 0)", content=b""),
    "more than can be counted": _npy("'<f8'", f"({'9' * 30},)"),
    "truth as a size": _npy("'<f8'", "(True,)"),
    "a negative size": _npy("'<f8'", "(-1,)"),
    "a size that is no number": _npy("'<f8'", "(1.0,)"),
    "a shape that is no tuple": _npy("'<f8'", "1"),
    "a literal that is never closed": _npy("'<f8'", "(1,"),
    "a literal that is deep": _npy("'<f8'", "(" * 4000 + ")" * 4000),
    "an expression": _npy("'<f8'", "(__import__('os').getpid(),)"),
    "a type with parts": _npy("[('a', '<f8')]", "(1,)"),
    "a type that is no text": _npy("8", "(1,)"),
    "times": _npy("'<M8[s]'", "(1,)"),
    "pointers": _npy("'|V8'", "(1,)"),
    "texts of no letters": _npy("'<U0'", "(1000000000000,)", content=b""),
    "texts of a gigabyte": _npy("'<U999999999'", "(1,)"),
    "numbers as wide as this machine's": _npy("'<f16'", "(1,)", content=bytes(16)),
    "what is no order": _npy("'<f8'", "(1,)", "0"),
    "fewer bytes": _npy("'<f8'", "(2,)"),
    "more bytes": _npy("'<f8'", "(1,)", content=bytes(9)),
    "half of a character": _npy("'<U1'", "(2,)", content=(0xD800).to_bytes(4, "little") * 2),
    "beyond all characters": _npy("'<U1'", "(2,)", content=b"\xff" * 8),
    "a header without end": b"\x93NUMPY\x02\x00\xff\xff\xff\xff{",
    "another version": b"\x93NUMPY\x09\x00\x10\x00" + bytes(16),
    "an axis too many": _npy("'<f8'", "(" + "1, " * 33 + ")"),
}


@pytest.mark.parametrize("name", HEADERS)
def test_headers_that_are_not_plain_are_refused(tmp_path, name):
    (tmp_path / "a.npy").write_bytes(HEADERS[name])
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("x.npy", HEADERS[name])
    for read, file in ((read_npy, "a.npy"), (read_npz, "a.npz")):
        with pytest.raises(UserError) as error:
            read(tmp_path / file)
        assert file in str(error.value) and len(str(error.value)) < 400
    if "character" not in name and name != "more bytes":
        with pytest.raises(UserError):
            list(npz_rows(tmp_path / "a.npz", "x", 2))


@pytest.mark.parametrize("version", [(1, 0), (2, 0), (3, 0)])
def test_every_version_of_the_format_is_read(tmp_path, version):
    with (tmp_path / "a.npy").open("wb") as file:
        np.lib.format.write_array(file, np.arange(3), version)
    assert read_npy(tmp_path / "a.npy").tolist() == [0, 1, 2]
    python2 = _npy("'<i8'", "(1L,)")
    (tmp_path / "a.npy").write_bytes(python2)
    assert read_npy(tmp_path / "a.npy").tolist() == [0]


def test_archives_of_another_kind_are_refused(tmp_path):
    content = _npy("'<f8'", "(1,)")
    cases = [(["x.npy", "x.npy"], zipfile.ZIP_STORED), (["."], zipfile.ZIP_STORED)]
    cases += [(["x.npy"], method) for method in (zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2)]
    for names, method in cases:
        with zipfile.ZipFile(tmp_path / "a.npz", "w", method) as archive, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for name in names:
                archive.writestr(name, content)
        with pytest.raises(UserError, match=r"a\.npz holds"):
            read_npz(tmp_path / "a.npz")


def test_what_systems_add_is_left_out(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        for name in ("x.npy", "._x.npy", "__MACOSX/x.npy"):
            archive.writestr(name, _npy("'<f8'", "(1,)") if name == "x.npy" else b"junk")
    assert read_npz(tmp_path / "a.npz").keys() == {"x"} and npz_names(tmp_path / "a.npz") == ["x"]


def test_what_is_no_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "a.npz")
    for path in (tmp_path, tmp_path / "a.npz", Path("/dev/zero")):
        for read in (read_npz, read_npy):
            with pytest.raises(UserError, match="is no regular file"):
                read(path)


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
