"""Files are whole or absent, and hashes tell contents apart."""

import hashlib

import numpy as np
import pytest

from grabnet.errors import UserError
from grabnet.files import existing, replacing, sha256, write_json


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "result.json"
    write_json(path, {"a": 1})
    before = path.read_text()
    with pytest.raises(RuntimeError), replacing(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_text() == before
    assert [p.name for p in tmp_path.iterdir()] == ["result.json"]


def test_folders_are_made_and_modes_are_ordinary(tmp_path):
    path = tmp_path / "a" / "b.txt"
    with replacing(path) as temporary:
        temporary.write_text("x")
    plain = tmp_path / "plain.txt"
    plain.write_text("x")
    assert path.stat().st_mode == plain.stat().st_mode


def test_hash_of_bytes_is_sha256_and_arrays_differ_by_shape_and_type(tmp_path):
    file = tmp_path / "f"
    file.write_bytes(b"abc")
    assert sha256(b"ab", "c") == sha256(file) == hashlib.sha256(b"abc").hexdigest()
    zeros = np.zeros(6)
    assert len({sha256(zeros), sha256(zeros.reshape(2, 3)), sha256(zeros.astype(np.float32)), sha256(zeros + 1)}) == 4
    assert sha256(np.arange(6).reshape(2, 3).T) == sha256(np.ascontiguousarray(np.arange(6).reshape(2, 3).T))


def test_a_missing_file_is_told_with_what_lies_beside(tmp_path):
    (tmp_path / "mug.ply").touch()
    with pytest.raises(UserError, match=r"Mesh .*cup\.ply does not exist; .* holds mug\.ply"):
        existing(tmp_path / "cup.ply", "Mesh")
    with pytest.raises(UserError, match="nor does its folder"):
        existing(tmp_path / "no" / "cup.ply", "Mesh")
    assert existing(tmp_path / "mug.ply", "Mesh") == tmp_path / "mug.ply"
