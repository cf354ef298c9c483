"""Files that are none, and buffers that lie elsewhere."""

import json
import os
import socket
import zlib
from pathlib import Path

import numpy as np
import pytest
import trimesh

from grabnet.errors import UserError
from grabnet.geometry.formats import reading
from grabnet.geometry.mesh import load_mesh, read_mesh

INPUTS = Path(__file__).parents[1] / "inputs"
BOX = trimesh.creation.box((0.06, 0.05, 0.1))


def as_pipe(path):
    os.mkfifo(path)


def as_folder(path):
    path.mkdir()


def as_device(path):
    path.symlink_to("/dev/zero")


def as_itself(path):
    path.symlink_to(path.name)


def as_socket(path):
    with socket.socket(socket.AF_UNIX) as server:
        os.chdir(path.parent)  # names of sockets are short
        server.bind(path.name)


@pytest.mark.parametrize("make", [as_pipe, as_folder, as_device, as_itself, as_socket])
@pytest.mark.parametrize("name", ["a.obj", "a.ply", "a.glb", "buffer.bin"])
def test_pipes_devices_and_folders_are_refused_unread(tmp_path, make, name, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / name
    make(path)
    if name == "buffer.bin":
        path = tmp_path / "a.gltf"
        path.write_text(json.dumps({"buffers": [{"uri": name, "byteLength": 4}]}))
    with pytest.raises(UserError, match=r"cannot be read|outside its own folder|not exist|no file name") as error:
        load_mesh(path)
    assert str(path) in str(error.value) or name in str(error.value)


def gltf(folder, uri: str):
    path = folder / "a.gltf"
    path.write_text(json.dumps({"asset": {"version": "2.0"}, "buffers": [{"uri": uri, "byteLength": 4}]}))
    return path


@pytest.mark.parametrize(
    ("uri", "said"),
    [
        ("", "it is a folder"),
        (".", "it is a folder"),
        ("a\0b", "no file name"),
        ("a\x1b[2Jb", "no file name"),
        ("x" * 3000, "cannot be opened"),
        ("/dev/zero", "outside its own folder"),
        ("inner/../../x.bin", "outside its own folder"),
        ("file:///etc/hostname", "'file:///etc/hostname', and file: addresses are not read: save it as .glb"),
        ("file:/etc/hostname", "and file: addresses are not read"),
        ("https://example.org/a.bin", "and https: addresses are not read: save it as .glb"),
    ],
)
def test_buffers_are_files_of_the_folder(tmp_path, uri, said):
    (tmp_path / "in").mkdir()
    (tmp_path / "x.bin").write_bytes(b"abcd")
    with pytest.raises(UserError, match=said):
        load_mesh(gltf(tmp_path / "in", uri))


def test_a_link_that_leads_out_of_the_folder_is_not_followed(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "secret.bin").write_bytes(b"abcd")
    (tmp_path / "in" / "b.bin").symlink_to("../secret.bin")
    with pytest.raises(UserError, match="outside its own folder"):
        load_mesh(gltf(tmp_path / "in", "b.bin"))


def test_a_file_too_large_is_refused_unread(tmp_path):
    path = tmp_path / "a.stl"
    path.touch()
    os.truncate(path, reading.MAX_BYTES + 1)
    with pytest.raises(UserError, match="has 512 MB, above 512 MB: simplify it"):
        load_mesh(path)


@pytest.mark.parametrize("true", ["obj", "ply", "stl", "off", "glb"])
@pytest.mark.parametrize("named", ["obj", "ply", "stl", "off", "glb", "gltf"])
def test_a_wrong_extension_is_said(tmp_path, true, named):
    path = tmp_path / f"a.{named}"
    data = BOX.export(file_type=true)
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    if true == named or {true, named} == {"glb", "gltf"}:
        assert load_mesh(path).volume == pytest.approx(3e-4, rel=1e-4)
    else:
        with pytest.raises(UserError, match=rf"what its extension \.{named} says: it looks like \.{true}, rename it"):
            load_mesh(path)


@pytest.mark.parametrize("path", sorted(INPUTS.iterdir()), ids=lambda path: path.name)
def test_damaged_files_end_in_a_sentence_or_a_mesh(path, tmp_path):
    """Bytes changed, cut out, doubled and moved."""
    data, rng = path.read_bytes(), np.random.default_rng(zlib.crc32(path.name.encode()))
    target = tmp_path / path.name
    for _ in range(20):
        broken = bytearray(data)
        for _ in range(rng.integers(1, 4)):
            at, length = rng.integers(len(broken)), int(rng.integers(1, 9))
            piece = broken[at : at + length]
            broken[at : at + length * int(rng.integers(2))] = rng.choice(
                [bytes(rng.bytes(length)), bytes(piece * 3), b"-1 ", b"9" * 9]
            )
        target.write_bytes(broken[: rng.integers(1, len(broken))] if rng.random() < 0.2 else broken)
        try:
            mesh = read_mesh(target)
            assert np.isfinite(mesh.vertices).all() and mesh.faces.max() < len(mesh.vertices)
        except UserError as error:
            assert str(error).isprintable() and path.name in str(error)


def test_no_message_is_a_librarys_alone(tmp_path):
    """JSON of the right outline and nonsense within."""
    for number, part in enumerate(
        ['"meshes":[{"primitives":[{"attributes":{"POSITION":0},"extensions":7}]}]', '"nodes":3']
    ):
        path = tmp_path / f"{number}.gltf"
        path.write_text('{"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],"accessors":[{}],' + part + "}")
        with pytest.raises(UserError, match=r"export it again"):
            load_mesh(path)
