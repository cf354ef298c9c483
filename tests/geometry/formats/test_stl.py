"""STL, ASCII and binary, known by what they hold."""

import numpy as np
import pytest
import trimesh

from grabnet.geometry.formats.geometry import FormatError
from grabnet.geometry.formats.stl import read

SOLID = trimesh.creation.box((1, 2, 3))
BINARY = SOLID.export(file_type="stl")
ASCII = SOLID.export(file_type="stl_ascii").encode()


def counted(n: int, data: bytes = BINARY) -> bytes:
    return data[:80] + n.to_bytes(4, "little") + data[84:]


@pytest.mark.parametrize(
    "data",
    [
        BINARY,
        BINARY + b"\r\n",
        b"solid made by a program that says so".ljust(80) + BINARY[80:],
        b"solid facet vertex".ljust(80) + BINARY[80:],
        b"solid with a tail".ljust(80) + BINARY[80:] + b"\0\0\0",
        counted(0),
        counted(0xFFFFFFFF),
        counted(0) + b"\r\n",
        counted(0xFFFFFFFF) + b"\0\0\0",
        b"solid facet vertex".ljust(80) + BINARY[80:] + b"\r\n",
        b"solid facet vertex".ljust(80) + counted(0xFFFFFFFF)[80:] + b"\n",
        ASCII,
        b"\xef\xbb\xbf" + ASCII,
        ASCII.decode().encode("utf-16"),
        ASCII.replace(b"\n", b"\r"),
        ASCII.upper(),
        ASCII.replace(b"solid", b"solid " + b"long " * 1000, 1),
        b"# a facet by solid work, vertex by vertex\n; more\n" + ASCII,
        b" ".join(ASCII.split()),
        b" ".join(ASCII.replace(b"solid", b"solid a vertex of a facet", 1).split()) + b" solid b endsolid b",
        ASCII.replace(b"endfacet", b"end facet").replace(b"endloop", b"end loop"),
        ASCII + b"\x1a\0\0",
        ASCII.replace(b"solid", b"  solid a vertex of a facet", 1) + b"\n\n",
        ASCII + ASCII.split(b"\n")[0] + b"\nendsolid\n",
    ],
)
def test_variants_are_the_same_solid(data):
    vertices, faces = read(data)
    np.testing.assert_allclose(vertices[faces], SOLID.triangles, atol=1e-6)


def test_several_solids_are_all_read():
    assert len(read(ASCII + ASCII).faces) == 24


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (BINARY[:-1], "ends before its 12 triangles"),
        (BINARY[:60], "ends before its 0 triangles"),
        (counted(6), "says 6 triangles and holds 12"),
        (counted(10**9), "ends before its 1000000000 triangles"),
        (ASCII[: len(ASCII) // 2], "ends within a solid|three each"),
        (ASCII.replace(b"endsolid", b""), "ends within a solid"),
        (ASCII.replace(b"vertex", b"vertex x", 1), "where a number is due"),
        (ASCII.replace(b"vertex", b"vertex 1", 1), "a vertex has other than three coordinates"),
        (ASCII.replace(b"endloop", b"vertex 0 0 0\nendloop", 1), "12 facets have 37 corners, not three each"),
    ],
)
def test_what_is_wrong_is_said(data, said):
    with pytest.raises(FormatError, match=said):
        read(data)
