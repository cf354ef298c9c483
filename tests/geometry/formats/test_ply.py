"""PLY of every layout: the same square, and what is broken."""

import struct
from collections.abc import Sequence

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from grabnet.geometry.formats.geometry import FormatError
from grabnet.geometry.formats.ply import read

PLACES = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 2, 0)]
CODES = {"uchar": "B", "int8": "b", "short": "h", "ushort": "H", "int": "i", "uint32": "I", "float": "f", "double": "d"}


def written(
    form: str,
    faces: Sequence[Sequence[int]] = ((0, 1, 2, 3), (2, 3, 4)),
    count: str = "uchar",
    index: str = "int",
    real: str = "float",
    name: str = "vertex_indices",
    before: Sequence[str] = (),
    after: Sequence[str] = (),
    newline: str = "\n",
) -> bytes:
    """A file, with further properties of faces `before` and `after` their corners, all 7."""
    lines = ["ply", f"format {form} 1.0", "comment element face 9", "obj_info x", "element other 2", "property int a"]
    lines += ["property list uchar short b", f"element vertex {len(PLACES)}"]
    lines += [f"property {real} x", "property uchar red", f"property {real} z", f"property {real} y"]
    lines += [f"element face {len(faces)}", *(f"property {kind} p{i}" for i, kind in enumerate(before))]
    lines += [f"property list {count} {index} {name}", *(f"property {kind} q{i}" for i, kind in enumerate(after))]
    rows = [[("int", 5), ("uchar", n), *(("short", 3),) * n] for n in (0, 2)]
    rows += [[(real, x), ("uchar", 9), (real, z), (real, y)] for x, y, z in PLACES]
    for face in faces:
        corners = [(count, len(face)), *((index, c) for c in face)]
        rows.append([*((kind, 7) for kind in before), *corners, *((kind, 7) for kind in after)])
    header = (newline.join([*lines, "end_header"]) + newline).encode()
    if form == "ascii":
        return header + newline.join(" ".join(str(v) for _, v in row) for row in rows).encode() + newline.encode()
    order = "<" if "little" in form else ">"
    return header + b"".join(struct.pack(order + CODES[kind], value) for row in rows for kind, value in row)


@settings(deadline=None, max_examples=40)
@given(
    form=st.sampled_from(["ascii", "binary_little_endian", "binary_big_endian"]),
    faces=st.lists(st.permutations(range(5)).flatmap(lambda p: st.integers(3, 5).map(lambda n: p[:n])), max_size=5),
    count=st.sampled_from(["uchar", "int8", "int", "ushort"]),
    index=st.sampled_from(["uchar", "short", "int", "uint32"]),
    real=st.sampled_from(["float", "double"]),
    name=st.sampled_from(["vertex_index", "vertex_indices"]),
    before=st.lists(st.sampled_from(sorted(CODES)), max_size=2),
    after=st.lists(st.sampled_from(sorted(CODES)), max_size=2),
    newline=st.sampled_from(["\n", "\r\n", "\r"]),
    tail=st.sampled_from([b"", b"\n", b"\0\0\0"]),
)
def test_every_layout_is_read(form, faces, count, index, real, name, before, after, newline, tail):
    data = written(form, faces, count, index, real, name, before, after, newline)
    vertices, triangles = read(data + (b"" if form == "ascii" else tail))
    np.testing.assert_array_equal(vertices, PLACES)
    assert len(triangles) == sum(len(face) - 2 for face in faces)
    at = 0
    for face in faces:
        assert set(triangles[at : at + len(face) - 2].ravel()) == set(face)
        at += len(face) - 2


def test_strips_turn_every_other_triangle_and_start_again_at_minus_one():
    header = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    text = header + "".join(f"{x} {y} {z}\n" for x, y, z in PLACES) + "8 0 1 2 3 -1 2 3 4\n"
    assert read(text.encode()).faces.tolist() == [[0, 1, 2], [2, 1, 3], [2, 3, 4]]


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_lines_may_end_in_several_ways(form):
    header, body = written(form).split(b"end_header\n")
    crlf = header.replace(b"\n", b"\r\n")
    for data in (
        header.replace(b"\n", b"\r\n", 1) + b"end_header\n",
        crlf + b"end_header\n",
        crlf + b"end_header \r\n",
        header + b"end_header\r\n",
    ):
        vertices, faces = read(data + body)
        np.testing.assert_array_equal(vertices, PLACES)
        assert len(faces) == 3


@pytest.mark.parametrize("tail", ["\x1a", "comment made by hand\n", "# 1 2\n"])
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-be"])
def test_text_in_any_encoding_and_with_more_behind_it(tail, encoding):
    vertices, faces = read((written("ascii").decode() + tail).encode(encoding))
    np.testing.assert_array_equal(vertices, PLACES)
    assert len(faces) == 3


def test_a_binary_body_may_begin_like_a_line_end():
    """After a CR alone, the first byte of the data is an LF."""
    data = trimesh.creation.box((1, 1, 1)).export(file_type="ply")
    head, body = data.split(b"end_header\n")
    first = struct.pack("<f", -0.5)
    body = body.replace(first, b"\x0a" + first[1:], 1)  # nearly -0.5
    vertices = read(head.replace(b"\n", b"\r") + b"end_header\r" + body).vertices
    np.testing.assert_allclose(np.abs(vertices), 0.5, atol=1e-6)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"plymouth", "does not start with ply"),
        (b"ply\nformat ascii 1.0\n", "its header has no end"),
        (b"ply\nformat text 1.0\nend_header\n", "its format is none of ascii"),
        (written("ascii").replace(b"float y", b"half y"), "the line 'property half y'"),
        (written("ascii").replace(b"float y", b"float x"), "two properties of one name"),
        (written("ascii").replace(b"float y", b"float w"), "vertices have no y"),
        (written("ascii").replace(b"vertex_indices", b"corners"), "face has no list vertex_indices"),
        (written("ascii").replace(b"\n5 ", b"\nfive "), "words where numbers are due"),
        (written("ascii")[:-6], "ends before its 2 of face"),
        (written("binary_big_endian")[:-1], "ends before its 2 of face"),
        (written("binary_little_endian", count="int8").replace(b"\x04\0\0", b"\xff\0\0"), "list of length -1"),
        (written("binary_little_endian").replace(b"face 2", b"face 999999999999"), "ends before its 999999999999"),
        (written("ascii", faces=[(0, 1, 9)]), "names vertex 9"),
    ],
)
def test_what_is_wrong_is_said(data, said):
    with pytest.raises(FormatError, match=said):
        read(data)
