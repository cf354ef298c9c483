"""OBJ as programs write it, and as they break it."""

import codecs

import numpy as np
import pytest

from grabnet.geometry.formats.geometry import FormatError
from grabnet.geometry.formats.obj import read

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
PLACES = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    "face",
    [
        "f 1 2 3",
        "f 1/1 2/2 3/3",
        "f 1//1 2//1 3//1",
        "f 1/1/1 2/2/1 3/3/1",
        "f -4 -3 -2",
        "f\t1\t2 3   ",
        "  f 1 2 3 # a comment 4",
        "f 1 2 \\\n 3",
        "f 1 \\ \n2 3",
        "f\\\n1\\\n2\\\n3",
        "mtllib C:\\tex\\\nf 1 2 3",
        "vn 0 0 \\\n1\no part\\\nf 1 2 3",
        "fo 1 2 3",
        "g a\ns off\nusemtl #3\nvn 0 0 1\nvt 0 0\nl 1 2\np 1\nf 1 2 3\nf 1 2",
        "# C:\\models\\\nf 1 2 3",
    ],
)
def test_faces_in_all_their_ways(face):
    vertices, faces = read((SQUARE + face + "\n").encode())
    np.testing.assert_array_equal(vertices, PLACES)
    assert faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize(
    "vertex", ["v 1 0 0 1.0", "v 1 0 0 .5 .5 .5", "v 1 0 0 1 .5 .5 .5", "v 1e0 -0 +0.0", "v\t1 0\t0 #x"]
)
def test_vertices_in_all_their_ways(vertex):
    assert read(f"v 0 0 0\n{vertex}\nv 0 1 0\nf 1 2 3".encode()).vertices[1].tolist() == [1, 0, 0]


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize(
    "encode",
    [
        lambda text: text.encode("utf-8-sig"),
        lambda text: text.encode("latin-1"),
        lambda text: text.encode("utf-16"),
        lambda text: codecs.BOM_UTF16_BE + text.encode("utf-16-be"),
        lambda text: text.encode("utf-16-le"),
        lambda text: text.encode("utf-16-be"),
        lambda text: codecs.BOM_UTF32_LE + text.encode("utf-32-le"),
    ],
)
def test_encodings_and_line_ends(newline, encode):
    vertices, faces = read(encode(("o Würfel\n" + SQUARE + "f 1 2 3\n").replace("\n", newline)))
    np.testing.assert_array_equal(vertices, PLACES)
    assert faces.tolist() == [[0, 1, 2]]


def test_a_line_does_not_end_within_a_name():
    """Characters at which other text breaks lines: 0x85 in Latin-1 and Windows, form feeds."""
    text = b"o a\x85v 9 9 9\ng b\x0cv 8 8 8\n" + SQUARE.encode() + b"f 1 2 3"
    np.testing.assert_array_equal(read(text).vertices, PLACES)


def test_negative_numbers_count_from_where_they_stand():
    text = SQUARE + "g a\nf -4 -3 -2\nv 5 5 5\ng b\nf -1 -2 1\n"
    assert read(text.encode()).faces.tolist() == [[0, 1, 2], [4, 3, 0]]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("hello", "no line starts with v"),
        ("v 0 0\nv 1 0\nv 0 1\nf 1 2 3", "vertex 1 has 2 coordinates; a solid needs three"),
        ("v 0,1 0 0", "a vertex has '0,1' where a number is due"),
        (SQUARE + "f 1 2 x", "face 1 has 'x' where a whole number is due"),
        (SQUARE + "f 0 1 2", "a face names vertex 0"),
        (SQUARE + "f 1 2 -5", "a face names vertex -5, of 4 so far"),
        (SQUARE + "f 1 2 5", "names vertex 4, counted from 0, of 4"),
        (SQUARE + "f 1 2 99999999999999999999999", "beyond all that there can be"),
        (SQUARE + "surf 0 1 0 1 1 2 3 4", "the statement 'surf' is not read: export it as polygons"),
    ],
)
def test_what_is_wrong_is_said(text, said):
    with pytest.raises(FormatError, match=said):
        read(text.encode())
