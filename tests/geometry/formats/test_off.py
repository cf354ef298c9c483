"""OFF with the headers that Geomview defines, and with those that programs write."""

import numpy as np
import pytest

from grabnet.geometry.formats.geometry import FormatError
from grabnet.geometry.formats.off import read

BODY = "4 2 0\n0 0 0{0}\n1 0 0{0}\n1 1 0{0}\n0 1 0{0}\n3 0 1 2{1}\n3 0 2 3{1}\n"
PLAIN = BODY.format("", "")


@pytest.mark.parametrize(
    "text",
    [
        "OFF\n" + PLAIN,
        "off\r\n" + PLAIN.replace("\n", "\r\n"),
        "OFF " + PLAIN,
        "OFF" + PLAIN,
        PLAIN,
        "\ufeffOFF\n" + PLAIN,
        "# made by hand\n\nOFF # header\n# more\n" + PLAIN.replace("\n", " # end\n\n"),
        "OFF\n" + PLAIN.replace("4 2 0", "4 2"),
        "OFF\n" + BODY.format("", " 255 0 0"),
        "COFF\n" + BODY.format(" 255 0 0 255", " 3 9"),
        "NOFF\n" + BODY.format(" 0 0 1", ""),
        "CNOFF\n" + BODY.format(" 0 0 1 1 0 0 1", ""),
        "STOFF\n" + BODY.format(" .5 .5", ""),
        "stcnoff" + BODY.format(" 0 0 1 1 0 0 1 .5 .5", ""),
        "OFF " + " ".join(PLAIN.split()),
        "OFF\n4 2 0\n" + " ".join(PLAIN.split()[3:]),
        "OFF\n4\n2\n" + PLAIN[4:],
        "OFF\n4 2\n" + PLAIN[4:],
        "COFF 4\n2 0\n" + BODY.format(" 255 0 0 255", " 3 9")[6:],
        "OFF\n" + "\n".join(PLAIN.split()),
        "OFF\n" + PLAIN + "\n# end\n1 2 3\n",
    ],
)
def test_headers_and_layouts(text):
    vertices, faces = read(text.encode())
    np.testing.assert_array_equal(vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_polygons_of_any_size():
    assert len(read(b"OFF\n4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n").faces) == 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("OFFSET\n" + PLAIN, "no numbers of vertices and faces"),
        ("OFF\n", "no numbers of vertices and faces"),
        ("OFF BINARY\n" + PLAIN, "OFF BINARY is not read"),
        ("4OFF\n" + PLAIN, "4OFF has other than three coordinates"),
        ("nOFF\n3\n" + PLAIN, "nOFF has other than three coordinates"),
        ("OFF\n" + PLAIN.replace("3 0 2 3\n", ""), "ends before its 4 vertices and 2 faces"),
        ("COFF\n" + PLAIN.replace("3 0 2 3\n", ""), "ends before its 4 vertices and 2 faces"),
        ("OFF\n" + PLAIN.replace("3 0 2 3", "4 0 2 3"), "face 1 has fewer than its 4 corners"),
        ("OFF\n" + PLAIN.replace("3 0 2 3", "3 0 2 9"), "names vertex 9"),
        ("OFF\n" + PLAIN.replace("1 1 0", "1 1"), "fewer than three coordinates"),
        ("OFF\n" + PLAIN.replace("1 1 0", "1 x 0"), "'x' where a number is due"),
        ("OFF\n999999999999 2 0\n0 0 0\n", "ends before"),
    ],
)
def test_what_is_wrong_is_said(text, said):
    with pytest.raises(FormatError, match=said):
        read(text.encode())
