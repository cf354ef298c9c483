"""Marker tables as capture software writes them, in all its dialects, and what is refused of them."""

from __future__ import annotations

import re

import numpy as np
import pytest

from grabnet.errors import UserError
from grabnet.mosh.tables import read_table

RATE = 120.0
LABELS = ("LKNE", "RKNE", "m1")


def positions(frames: int = 5) -> np.ndarray:
    """(T, 3, 3) metres, of a body's size; one marker is missing once, and one in the last frame."""
    places = np.random.default_rng(0).uniform(-0.9, 0.9, (frames, 3, 3))
    places[2, 1] = np.nan
    places[-1, 2] = np.nan
    return places


def cells(scale: float = 1e3) -> list[list[str]]:
    return [["" if np.isnan(x) else f"{x:.8f}" for x in frame.ravel()] for frame in scale * positions()]


def spread(names: tuple[str, ...]) -> list[str]:
    """Names of markers, each over its X."""
    return [cell for name in names for cell in (name, "", "")]


def trc() -> list[list[str]]:
    return [
        ["PathFileType", "4", "(X/Y/Z)", "x.trc"],
        ["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate"],
        ["120.00", "120.00", "5", "3", "mm", "120"],
        ["Frame#", "Time", *spread(LABELS)],
        ["", "", *(f"{axis}{k}" for k in (1, 2, 3) for axis in "XYZ")],
        [],
        *([str(t + 1), f"{t / 120:.5f}", *row] for t, row in enumerate(cells())),
    ]


def vicon() -> list[list[str]]:
    return [
        ["Trajectories"],
        ["120"],
        ["", "", *spread(LABELS)],
        ["Frame", "Sub Frame", *"XYZ" * 3],
        ["", "", *["mm"] * 9],
        *([str(t + 1), "0", *row] for t, row in enumerate(cells())),
    ]


def vicon_after_others() -> list[list[str]]:
    """As Nexus writes it with model outputs before, whose columns have axes, too, and devices after."""
    outputs = [
        ["Model Outputs"],
        ["120"],
        ["", "", "s:LAnkleAngles", "", ""],
        ["Frame", "Sub Frame", "X", "Y", "Z"],
        ["", "", "deg", "deg", "deg"],
        *([str(t), "0", "1", "2", "3"] for t in range(1, 6)),
        [],
    ]
    return [*outputs, *vicon(), [], ["Devices"], ["1000"], ["", "", "Force"], ["1", "0", "7"]]


def two_rows() -> list[list[str]]:
    """Two rows of header, nameless frames and the time; the rate follows from it."""
    body = [[str(t + 1), f"{t / 120:.6f}", *row] for t, row in enumerate(cells())]
    return [["", "", *spread(LABELS)], ["Frame", "Time", *"XYZ" * 3], *body]


def motive() -> list[list[str]]:
    """A rigid body's pose and its own markers stand before the measured ones."""
    names = [name for name in LABELS for _ in range(3)]
    facts = {
        "Format Version": "1.23", "Take Name": "Take 1", "Take Notes": "", "Capture Frame Rate": "240.000000",
        "Export Frame Rate": "120.000000", "Total Frames in Take": "10", "Total Exported Frames": "5",
        "Rotation Type": "Quaternion", "Length Units": "Meters", "Coordinate Space": "Global",
    }  # fmt: skip
    return [
        [cell for fact in facts.items() for cell in fact],
        [],
        ["", "Type", *["Rigid Body"] * 8, *["Rigid Body Marker"] * 8, *["Marker"] * 9],
        ["", "Name", *["mug"] * 8, *["mug:Marker1"] * 4, *["mug:Marker2"] * 4, *names],
        ["", "ID", *["7"] * 25],
        ["", "", *["Rotation"] * 4, *["Position"] * 3, "Mean Marker Error",
         *[*["Position"] * 3, "Marker Quality"] * 2, *["Position"] * 9],
        ["Frame", "Time (Seconds)", *"XYZW", *"XYZ", "", *[*"XYZ", ""] * 2, *"XYZ" * 3],
        *([str(t), f"{t / 120:.6f}", *[f"0.{k}" for k in range(10, 26)], *row] for t, row in enumerate(cells(1))),
    ]  # fmt: skip


def qualisys(named: bool = True, first: int = 0) -> list[list[str]]:
    head = [["NO_OF_FRAMES", "5"], ["FREQUENCY", "120"], ["DATA_INCLUDED", "3D"], ["MARKER_NAMES", *LABELS]]
    columns = [[*["Frame", "Time"][:first], *(f"{name} {axis}" for name in LABELS for axis in "XYZ")]]
    body = [[*[str(t + 1), f"{t / 120:.5f}"][:first], *row] for t, row in enumerate(cells())]
    return [*head, *columns * named, *body]


def plain() -> list[list[str]]:
    """With a column whose name ends in an axis, but is none."""
    header = ["index", "time", *(f"{name}_{axis}" for name in LABELS for axis in "xyz")]
    return [header, *([str(t), f"{t / 120:.6f}", *row] for t, row in enumerate(cells()))]


def text(rows: list[list[str]], delimiter: str = ",", comma: bool = False, end: str = "\n") -> str:
    """A table; with `comma`, numbers have decimal commas."""
    decimal = [[re.sub(r"(?<=\d)\.(?=\d)", ",", cell) if comma else cell for cell in row] for row in rows]
    return end.join(delimiter.join(row) for row in decimal) + end


def check(path, rate: float = RATE) -> None:
    found = read_table(path)
    assert found.labels == LABELS and found.rate == pytest.approx(rate, rel=1e-3)
    np.testing.assert_allclose(found.positions, positions(), atol=1e-7)


DIALECTS = {
    "a.trc": (trc, "\t"),
    "b.csv": (vicon, ","),
    "c.csv": (vicon_after_others, ","),
    "d.csv": (two_rows, ","),
    "e.csv": (motive, ","),
    "f.tsv": (qualisys, "\t"),
    "g.csv": (plain, ","),
}


@pytest.mark.parametrize("name", DIALECTS)
def test_every_dialect_comes_back_in_metres(tmp_path, name):
    make, delimiter = DIALECTS[name]
    (tmp_path / name).write_text(text(make(), delimiter))
    check(tmp_path / name)


@pytest.mark.parametrize("name", DIALECTS)
@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_decimal_commas(tmp_path, name, delimiter):
    """As software set to a European language writes them."""
    (tmp_path / name).write_text(text(DIALECTS[name][0](), delimiter, comma=True))
    check(tmp_path / name)


def test_quoted_decimal_commas(tmp_path):
    quoted = [[f'"{cell}"' for cell in row] for row in plain()]
    (tmp_path / "x.csv").write_text(text(quoted, ",", comma=True))
    check(tmp_path / "x.csv")


@pytest.mark.parametrize("name", DIALECTS)
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
@pytest.mark.parametrize("end", ["\r\n", "\r"])
def test_encodings_and_line_ends(tmp_path, name, encoding, end):
    make, delimiter = DIALECTS[name]
    content = text(make(), delimiter, end=end).replace("RKNE", "RKNÉ")
    (tmp_path / name).write_bytes(content.encode(encoding))
    assert read_table(tmp_path / name).labels == ("LKNE", "RKNÉ", "m1")


@pytest.mark.parametrize("first", [0, 1, 2])
@pytest.mark.parametrize("named", [False, True])
def test_qualisys_with_and_without_frame_time_and_names(tmp_path, first, named):
    (tmp_path / "x.tsv").write_text(text(qualisys(named, first), "\t"))
    check(tmp_path / "x.tsv")


def test_qualisys_whose_last_marker_is_never_there_is_not_shifted(tmp_path):
    rows = [[*row[:6], "", "", ""] if row[0][:1] in "-0123456789" and len(row) > 5 else row for row in qualisys(False)]
    (tmp_path / "x.tsv").write_text(text(rows, "\t"))
    found = read_table(tmp_path / "x.tsv")
    np.testing.assert_allclose(found.positions[:, :2], positions()[:, :2], atol=1e-7)
    assert np.isnan(found.positions[:, 2]).all()


def test_markers_without_a_label_shift_none(tmp_path):
    rows = vicon()
    rows[2][2] = ""  # of the first marker
    (tmp_path / "x.csv").write_text(text(rows))
    found = read_table(tmp_path / "x.csv")
    assert found.labels == LABELS[1:] and "1 unlabelled points are left out." in found.notes
    np.testing.assert_allclose(found.positions, positions()[:, 1:], atol=1e-7)


def test_motive_without_measured_markers_has_those_of_its_models(tmp_path):
    (tmp_path / "x.csv").write_text(text([motive()[0], *(row[:-9] for row in motive()[1:])]))
    found = read_table(tmp_path / "x.csv")
    assert found.labels == ("mug:Marker1", "mug:Marker2")
    np.testing.assert_allclose(found.positions[0], [[0.18, 0.19, 0.20], [0.22, 0.23, 0.24]])


def test_words_for_missing_markers(tmp_path):
    rows = [["nan" if cell == "" else cell for cell in row] for row in plain()]
    (tmp_path / "x.csv").write_text(text(rows))
    check(tmp_path / "x.csv")


def test_a_last_row_without_a_line_end_is_whole(tmp_path):
    (tmp_path / "x.csv").write_text(text(plain()).removesuffix("\n"))
    check(tmp_path / "x.csv")


def without(rows: list[list[str]], number: int) -> list[list[str]]:
    return [row for i, row in enumerate(rows) if i != number]


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("a,b\n1,2\n", "no marker table that is known"),
        ("", "no marker table that is known"),
        ("A_x,A_y,A_z\n1,2,3\n", "how many frames it has per second: give reading.rate=120"),
        ("A_x,A_z,A_y\n1,2,3\n", "must come as x, y, z"),
        ("A_x,B_y,A_y,A_z\n1,2,3,4\n", "must come as x, y, z"),
        ("Trajectories\n120\n", "is cut off within its header"),
        (text(vicon()[:4]), "holds 0 frames"),
        (text(trc()[:5], "\t"), "is cut off: it has 0 of the 5 frames"),
        (text(trc()[:-1], "\t"), "is cut off: it has 4 of the 5 frames that its header announces"),
        (text(qualisys()[:-2], "\t"), "is cut off: it has 3 of the 5 frames"),
        (text(motive()[:-1]), "is cut off: it has 4 of the 5 frames"),
        (text(motive()[:5]), "lacks the rows Type, Name and X, Y, Z"),
        (text(vicon())[:-20], "is cut off within its last frame"),
        (text(plain(), comma=True), "numbers with decimal commas need semicolons or tabs"),
        (text(without(vicon(), 6)), "frame 1 is followed by frame 3: export all frames, in order"),
        (text(plain()).replace(cells()[1][0], "12.3.4"), r"frame 2 has 12.3.4, .* as the place of LKNE, .* no numbers"),
        (text(plain()).replace(cells()[1][0], "#REF!"), "as the place of LKNE, which are no numbers"),
        (text(vicon()).replace("mm", "deg"), "in the unit 'deg', which is no length"),
        (text(vicon()).replace("mm", "m"), "which no capture does: give the right reading.unit="),
        (text([row[2:] if row[:2] == ["", ""] else row for row in trc()], "\t"), "does not stand above an X, Y, Z"),
    ],
)
def test_tables_that_cannot_be_read(tmp_path, content, sentence):
    (tmp_path / "x.csv").write_text(content)
    with pytest.raises(UserError, match=sentence):
        read_table(tmp_path / "x.csv")


@pytest.mark.parametrize("data", [b"\xff\xfe\x00", b"A_x,A_y,A_z\n\x00\x00", bytes(range(256)) * 3])
def test_what_is_no_text(tmp_path, data):
    (tmp_path / "x.csv").write_bytes(data)
    with pytest.raises(UserError, match="is no text"):
        read_table(tmp_path / "x.csv")


def timed(make, times: list[float], step: int = 1) -> str:
    """A table with these times, whose frames count by `step`."""
    rows, start = make(), -5
    if make is trc:
        rows[2] = ["120.00", "120.00", str(len(times)), "3", "mm", "120"]
    body = [[str(step * t), f"{time:.6f}", *rows[start][2:]] for t, time in enumerate(times)]
    return text([*rows[:start], *body], "\t")


EVEN = [t / 120 for t in range(6)]


@pytest.mark.parametrize("make", [trc, two_rows, plain, motive, lambda: qualisys(first=2)])
@pytest.mark.parametrize(
    ("times", "step", "sentence"),
    [
        ([*EVEN[:3], *(time + 1 for time in EVEN[3:])], 1, "frame 3 of the table is at .* s and the next one at .* s"),
        ([*EVEN[:4], EVEN[5]], 1, "frame 4 of the table"),
        ([*EVEN[:3], *EVEN[2:]], 1, "frame 3 of the table"),
        ([*EVEN[:5], 0.0], 1, "frame 5 of the table"),
        ([2 * time for time in EVEN], 2, "says that it has 120 frames per second, and has 60 by its column Time"),
        ([2 * time for time in EVEN], 1, "says that it has 120 frames per second, and has 60 by its column Time"),
    ],
)
def test_times_that_leave_frames_out_or_contradict_the_rate(tmp_path, make, times, step, sentence):
    (tmp_path / "x.csv").write_text(timed(make, times, step))
    if make in (two_rows, plain) and sentence.startswith("says"):  # no other rate is said
        assert read_table(tmp_path / "x.csv").rate == pytest.approx(60, rel=1e-3)
    else:
        with pytest.raises(UserError, match=sentence):
            read_table(tmp_path / "x.csv")
    assert read_table(tmp_path / "x.csv", rate=90).rate == 90, "what is given counts"


def test_rounded_times_and_numbers_that_count_by_two_are_right(tmp_path):
    (tmp_path / "x.trc").write_text(timed(trc, [round(time, 3) for time in EVEN], 2))
    assert read_table(tmp_path / "x.trc").rate == RATE
    rows = [*vicon()[:5], *([str(2 * t), *row[1:]] for t, row in enumerate(vicon()[5:]))]
    (tmp_path / "x.csv").write_text(text(rows))
    with pytest.raises(UserError, match="its frames count by 2, and it has no column Time"):
        read_table(tmp_path / "x.csv")
    assert read_table(tmp_path / "x.csv", rate=60).rate == 60


@pytest.mark.parametrize("name", DIALECTS)
def test_empty_lines_before_the_header(tmp_path, name):
    make, delimiter = DIALECTS[name]
    (tmp_path / name).write_text("\n" + 3 * delimiter + "\n" + text(make(), delimiter))
    check(tmp_path / name)


def test_times_that_stand_still(tmp_path):
    (tmp_path / "x.trc").write_text(timed(trc, [0.0] * 6))
    with pytest.raises(UserError, match="frame 1 of the table is at 0 s and the next one at 0 s"):
        read_table(tmp_path / "x.trc")
