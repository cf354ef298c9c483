"""Files are whole or absent, and hashes tell contents apart."""

import hashlib

import numpy as np
import pytest
import torch

from grabnet.data.frames import finish_store
from grabnet.errors import UserError
from grabnet.geometry.bps import BPS
from grabnet.io.files import existing, filling, replacing, sha256, write_json
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.weights import save_network
from grabnet.open.grasps.store import load_open_grasps, save_open_grasps
from tests.faults import files_of_at_most


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "result.json"
    write_json(path, {"a": 1})
    before = path.read_text()
    with pytest.raises(RuntimeError), replacing(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_text() == before
    assert [p.name for p in tmp_path.iterdir()] == ["result.json"]


@pytest.mark.parametrize(
    "write",
    [
        lambda folder: save_network(folder / "a.safetensors", CoarseNet(BPS(64), width=32, n_hidden=16), {}),
        lambda folder: finish_store(folder, "", {"s1": torch.zeros(778, 3)}, [], {}),
        lambda folder: save_open_grasps(folder / "a.safetensors", load_open_grasps()),
    ],
    ids=["network", "subjects", "grasps"],
)
def test_a_full_disk_is_an_os_error_whatever_is_written(write, tmp_path):
    with files_of_at_most(4096), pytest.raises(OSError, match="File too large"):
        write(tmp_path)
    assert not [p for p in tmp_path.iterdir() if p.stat().st_size > 4096 or p.name.startswith(".")]


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


def test_what_is_not_of_earlier_results_is_never_deleted(tmp_path):
    """Files of the user's beside results, in a folder that is called like one of them, and called like a result."""
    names = ("meshes/hand_*.ply", "page.html", "done.json")
    mine = tmp_path / "meshes" / "scan.obj"
    mine.parent.mkdir()
    mine.write_text("mine")

    def fill(*written: str) -> None:
        with filling(tmp_path, names, lambda folder: (folder / "done.json").exists()) as temporary:
            (temporary / "meshes").mkdir()
            for name in written:
                (temporary / name).write_text("ours")

    fill("meshes/hand_0.ply", "meshes/hand_1.ply", "done.json")
    fill("meshes/hand_1.ply", "page.html", "done.json")
    found = [str(p.relative_to(tmp_path)) for p in sorted(tmp_path.rglob("*")) if p.is_file()]
    assert found == ["done.json", "meshes/hand_1.ply", "meshes/scan.obj", "page.html"]
    mine.unlink()
    fill("done.json")
    assert [p.name for p in tmp_path.iterdir()] == ["done.json"]
    for name in ("page.html", "meshes/hand_7.ply"):
        (tmp_path / "done.json").unlink()
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("mine")
        with pytest.raises(UserError, match=f"{name} is not of earlier results: move it, or choose another folder"):
            fill("done.json")
        assert (tmp_path / name).read_text() == "mine"
        (tmp_path / name).unlink()
        fill("done.json")
