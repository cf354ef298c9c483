"""Marker files: every trap that real ones hold (ref. 12)."""

from __future__ import annotations

import struct
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from grabnet.errors import UserError
from grabnet.mosh.captures import find_captures, read_capture
from grabnet.mosh.markers import markers_of, scale_of

RATE = 120.0
LABELS = ("s1:LKNE", "s1:RKNE", "mug:m1")
MOCAP = Path(__file__).parents[3] / "shared/mocap"


def positions(frames: int = 5) -> np.ndarray:
    """(T, 3, 3) metres, of a body's size; one marker is missing once."""
    places = np.random.default_rng(0).uniform(-0.9, 0.9, (frames, 3, 3))
    places[2, 1] = np.nan
    return places


@pytest.fixture
def c3d(tmp_path):
    from grabnet.mosh.c3d import write_c3d

    def make(change=None, labels=LABELS, unit="mm", places=None) -> Path:
        path = tmp_path / "capture.c3d"
        write_c3d(path, labels, positions() if places is None else places, RATE, unit)
        if change is not None:
            file = ezc3d.c3d(str(path))
            change(file)
            file.write(str(path))
        return path

    return make


def point(name: str, value: list):
    """A change of one of the parameters of POINT."""

    def change(file) -> None:
        if name in file["parameters"]["POINT"]:
            file["parameters"]["POINT"][name]["value"] = value
        else:
            file.add_parameter("POINT", name, value)

    return change


@pytest.mark.parametrize("unit", ["mm", "m"])
def test_c3d_comes_back_in_metres(c3d, unit):
    found = read_capture(c3d(unit=unit))
    assert found.labels == LABELS and found.rate == RATE and found.prefixes == ("s1", "mug")
    np.testing.assert_allclose(found.positions, positions(), atol=1e-6)
    assert found.under("mug").labels == ("m1",) and found.pick(["x"]).seen.sum() == 0
    with pytest.raises(UserError, match="prefix 's2'; the labels' prefixes are s1, mug"):
        found.under("s2")


@pytest.mark.parametrize(
    ("units", "scale"), [(["mete"], 1.0), (["mm"] * 3, 1.0), (["millim"], 1.0), ([""], 1.0), (["MM"], 1.0)]
)
def test_units_cut_off_repeated_and_missing(c3d, units, scale):
    unit = "m" if units[0].startswith("mete") else "mm"
    found = read_capture(c3d(point("UNITS", units), unit=unit))
    np.testing.assert_allclose(found.positions, scale * positions(), atol=1e-6)
    assert bool(found.notes) == (units == [""]), "a unit that is guessed is said"


def test_names_of_units():
    assert [scale_of(name) for name in ("m", "meter", "Metres", "mete", "mm", "cm", "inch")] == [
        1, 1, 1, 1, 1e-3, 1e-2, 0.0254,
    ]  # fmt: skip
    assert scale_of("deg") is None and scale_of("") is None and scale_of("rad") is None


def test_wrong_units_are_refused(c3d):
    with pytest.raises(UserError, match=r"lie 1.?\d* ?\d* m apart|apart when read in"):
        read_capture(c3d(point("UNITS", ["m"])))  # millimetres that claim to be metres
    assert len(read_capture(c3d(point("UNITS", ["m"])), unit="mm")) == 5
    with pytest.raises(UserError, match="in the unit 'deg', which is no length"):
        read_capture(c3d(point("UNITS", ["deg"])))


def test_missing_points_by_all_three_conventions(c3d):
    places = positions()
    places[0, 0] = np.nan
    places[1, 2] = 0  # zeros

    def negative(file) -> None:
        file["data"]["meta_points"]["residuals"][0, 1, 3] = -1

    found = read_capture(c3d(negative, places=places))
    expected = np.ones((5, 3), bool)
    expected[[0, 1, 2, 3], [0, 2, 1, 1]] = False
    np.testing.assert_array_equal(found.seen, expected)


def test_angles_and_other_outputs_are_left_out(c3d):
    labels = ("s1:LKNE", "s1:LKneeAngles", "s1:Odd")
    found = read_capture(c3d(point("FORCES", ["s1:Odd"]), labels=labels))
    assert found.labels == ("s1:LKNE",) and "2 points that are no markers" in found.notes[0]


def test_labels_that_repeat_or_lack(c3d):
    found = read_capture(c3d(point("LABELS", ["A", "A", ""])))
    assert found.labels == ("A", "A (2)") and "A occurs more than once" in found.notes[0]
    assert "1 unlabelled points" in found.notes[1]


def test_damaged_and_foreign_files_are_refused(c3d, tmp_path):
    path = c3d()
    whole = path.read_bytes()
    path.write_bytes(whole[:-400])
    with pytest.raises(UserError, match="is cut off: it has"):
        read_capture(path)
    start = 512 * (whole[0] - 1)
    path.write_bytes(whole[: start + 3] + bytes([86]) + whole[start + 4 :])
    with pytest.raises(UserError, match="SGI/MIPS"):
        read_capture(path)
    path.write_bytes(b"PK" * 400)
    with pytest.raises(UserError, match="is no c3d file"):
        read_capture(path)
    path.write_bytes(b"")
    with pytest.raises(UserError, match="is no c3d file"):
        read_capture(path)
    with pytest.raises(UserError, match="is no capture: its suffix"):
        (tmp_path / "x.txt").write_text("")
        read_capture(tmp_path / "x.txt")


def header(path: Path, first: int, last: int) -> bytes:
    """The file's bytes with other numbers of the first and last frame in its header."""
    whole = path.read_bytes()
    return whole[:6] + struct.pack("<2H", first, last) + whole[10:]


@pytest.mark.parametrize(("first", "last"), [(1, 0), (0, 0), (1, 5), (1, 65535)])
def test_files_that_end_before_their_frames(c3d, first, last):
    path = c3d()
    start = 512 * (path.read_bytes()[16] - 1)
    path.write_bytes(header(path, first, last)[:start])
    with pytest.raises(UserError, match="holds no frames: it ends where they should start"):
        read_capture(path)


def test_files_whose_last_frame_is_before_the_first(c3d):
    path = c3d()
    path.write_bytes(header(path, 2, 1))
    with pytest.raises(UserError, match="holds 0 frames"):
        read_capture(path)


def test_long_files_that_are_cut_off_are_known_by_their_parameters(c3d):
    """Their header cannot say how many frames they have."""
    path = c3d(places=positions(300))
    path.write_bytes(header(path, 1, 65535)[:-6000])
    with pytest.raises(UserError, match="is cut off: it has"):
        read_capture(path)


def test_files_longer_than_the_reader_reads_are_refused(c3d):
    places = np.full((65_535, 1, 3), 0.5)
    places[:, :, 0] = np.linspace(0, 1, 65_535)[:, None]
    path = c3d(labels=LABELS[:1], places=places)
    assert len(read_capture(path)) == 65_535
    with path.open("ab") as file:
        file.write(bytes(16 * 100))
    with pytest.raises(UserError, match="has more than the 65,535 frames"):
        read_capture(path)
    with pytest.raises(UserError, match="would have 65,536 frames; a c3d file takes 65,535"):
        c3d(labels=LABELS[:1], places=np.zeros((65_536, 1, 3)))


def test_what_no_file_may_hold():
    places = positions()
    for labels, values, rate, sentence in (
        ([], places[:, :0], RATE, "analog data only"),
        (LABELS, places[:0], RATE, "holds 0 frames"),
        (LABELS, places, 0.0, "0.0 frames per second"),
        (LABELS, np.full_like(places, np.nan), RATE, "missing in all 5 frames"),
        (["*1", "*2", "*3"], places, RATE, "none of them a labelled marker"),
    ):
        with pytest.raises(UserError, match=sentence):
            markers_of("f.c3d", labels, values, rate, "m")
    with pytest.raises(UserError, match="names no unit"):
        markers_of("f.c3d", LABELS, 60 * places, RATE, "")


def test_up_is_z_whatever_the_file_has():
    places = np.array([[[0.0, 1, 0], [0.3, 0, 0], [0, 0, 1.2]]])
    turned = markers_of("f", LABELS, places, RATE, "m", up="y").positions
    assert turned[0, 0].tolist() == [0, 0, 1]  # what was up
    sides = np.linalg.det(places[0]), np.linalg.det(turned[0])
    assert sides[0] == pytest.approx(sides[1]), "turned, not mirrored"


def test_captures_of_a_folder(tmp_path):
    with pytest.raises(UserError, match="holds no captures"):
        find_captures(tmp_path)
    for name in ("b.c3d", "a.trc", "notes.txt"):
        (tmp_path / name).write_text("")
    for name in ("._b.c3d", ".a-12345678.trc", "b (1).c3d"):
        (tmp_path / name).write_text("")
    (tmp_path / "a.csv").mkdir()
    assert [path.name for path in find_captures(tmp_path)] == ["a.trc", "b.c3d"]


@pytest.mark.skipif(not MOCAP.exists(), reason="the real recordings are not here")
def test_real_recordings():
    box = read_capture(MOCAP / "box_and_subject.c3d")
    assert box.prefixes == ("boite", "Daphnee") and len(box.under("boite").labels) == 8 and len(box) == 580
    serve = read_capture(MOCAP / "tennis_serve.c3d")
    assert len(serve.labels) == 39 and serve.rate == 50
    assert 1.0 < np.nanmax(serve.positions[..., 2]) < 3.0, "metres"
