"""Checkpoints that may be another's: what torch saved comes back, and none takes time, memory or trust without end."""

from __future__ import annotations

import io
import os
import pickle
import zipfile
from collections import OrderedDict

import pytest
import torch

from grabnet.errors import UserError
from grabnet.io.checkpoints import read_checkpoint
from tests.io.test_pickles import ENDLESS


def _read(path):
    return read_checkpoint(path, "Checkpoint", "delete it")


def _with_pickle(path, change) -> None:
    """The same checkpoint with another pickle in it."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, change(content) if name.endswith("/data.pkl") else content)


@pytest.mark.parametrize("zipped", [True, False])
def test_what_torch_saved_comes_back(tmp_path, zipped):
    network = torch.nn.Linear(3, 2)
    optimizer = torch.optim.Adam(network.parameters())
    network(torch.ones(1, 3)).sum().backward()
    optimizer.step()
    whole = {
        "state_dict": network.state_dict(), "optimizer_states": [optimizer.state_dict()], "epoch": 3, "nothing": None,
        "half": torch.ones(3).half(), "bfloat": torch.ones(2).bfloat16(), "bool": torch.tensor([True]), "set": {1, 2},
        "view": torch.arange(10)[2:5], "empty": torch.zeros(0, 3), "size": torch.Size([3]), "type": torch.float32,
    }  # fmt: skip
    torch.save(whole, tmp_path / "a.pt", _use_new_zipfile_serialization=zipped)
    found = _read(tmp_path / "a.pt")
    assert found.keys() == whole.keys() and isinstance(found["state_dict"], OrderedDict)
    for name in ("half", "bfloat", "bool", "view", "empty"):
        torch.testing.assert_close(found[name], whole[name])
    network.load_state_dict(found["state_dict"])
    optimizer.load_state_dict(found["optimizer_states"][0])
    assert (found["set"], found["size"], found["type"], found["epoch"]) == ({1, 2}, torch.Size([3]), torch.float32, 3)


@pytest.mark.parametrize("zipped", [True, False])
def test_what_is_no_dense_tensor_is_refused(tmp_path, zipped):
    for value in (torch.zeros(1).expand(10**6, 10**6), torch.zeros(10**12, 0), torch.eye(2).to_sparse()):
        torch.save({"a": value}, tmp_path / "a.pt", _use_new_zipfile_serialization=zipped)
        with pytest.raises(UserError, match=r"a\.pt cannot be read .*: delete it\."):
            _read(tmp_path / "a.pt")


@pytest.mark.parametrize("zipped", [True, False])
def test_a_storage_larger_than_the_file_is_refused(tmp_path, zipped):
    path = tmp_path / "a.pt"
    torch.save({"a": torch.zeros(1000)}, path, _use_new_zipfile_serialization=zipped)
    old, new = b"M\xe8\x03", b"J\x00\x00\x00\x7f"  # 1000, and two billion
    if zipped:
        _with_pickle(path, lambda content: content.replace(old, new))
    else:
        path.write_bytes(path.read_bytes().replace(old, new))
    with pytest.raises(UserError, match="not as many bytes as"):
        _read(path)


@pytest.mark.parametrize("name", [n for n in ENDLESS if "shared" not in n and n not in ("half a character",)])
def test_pickles_of_much_work_are_refused(tmp_path, name):
    path = tmp_path / "a.pt"
    torch.save({"a": torch.zeros(1)}, path)
    _with_pickle(path, lambda content: ENDLESS[name])
    with pytest.raises(UserError, match="cannot be read"):
        _read(path)


def test_nothing_in_one_is_run(tmp_path):
    class Bomb:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "crater"),)

    torch.save({"a": Bomb()}, tmp_path / "a.pt")
    with pytest.raises(UserError, match=r"holds a pickled posix\.mkdir"):
        _read(tmp_path / "a.pt")
    stream = io.BytesIO()
    for value in (0x1950A86A20F9469CFC6C, 1001, {}, Bomb(), []):  # as torch wrote them before 1.6
        pickle.dump(value, stream, protocol=2)
    (tmp_path / "b.pt").write_bytes(stream.getvalue())
    with pytest.raises(UserError, match=r"holds a pickled posix\.mkdir"):
        _read(tmp_path / "b.pt")
    assert not (tmp_path / "crater").exists()
