"""What the header of a marker table says, in the dialects of capture software.

    .trc                    PathFileType; labels above X1, Y1, Z1, …
    Vicon Nexus' .csv       a section Trajectories, perhaps after others; labels above X, Y, Z, and units below
    two rows                labels above X, Y, Z, and nothing else
    OptiTrack Motive's .csv Format Version; rows of types and names, rotations beside positions
    Qualisys' .tsv          MARKER_NAMES, and columns without a name
    plain                   columns LABEL_x, LABEL_y, LABEL_z (LABEL.x, LABEL:x, LABEL X); Frame and Time, if any

Source: tables as this software writes them (ref. 12).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grabnet.errors import UserError

Rows = list[list[str]]

_AXIS = re.compile(r"([XYZ])\d*", re.IGNORECASE)
_COORDINATE = re.compile(r"(?P<label>.+?)[\s_.:-]*(?P<axis>[xyz])", re.IGNORECASE)
_MISSING = {"", "-", ".", "nan", "na", "n/a", "null", "none", "missing"}
# Motive's types of columns that are markers: as measured, or else as its models have them.
_MOTIVE_TYPES = ({"marker"}, {"rigid body marker", "bone marker"})


@dataclass(frozen=True)
class Table:
    """A table whose header is understood.

    Attributes:
        labels: one per marker, "" where it has none.
        columns: of the x of each marker; y and z follow.
        rows: of text, one a frame.
        width: of the header, in cells.
        rate: frames per second, if said.
        unit: as said.
        announced: how many frames there should be, if said.
        frame, time: columns of the frame's number and of seconds, if there.
    """

    labels: Sequence[str]
    columns: Sequence[int]
    rows: Rows
    width: int
    rate: float | None = None
    unit: str = ""
    announced: int | None = None
    frame: int | None = None
    time: int | None = None


def understood(path: object, rows: Rows) -> Table | None:
    """The table that rows of cells are; None where they are of no dialect that is known.

    Raises:
        UserError: the header is cut off, or not as its dialect has it.
    """
    rows = rows[next((i for i, row in enumerate(rows) if any(row)), len(rows)) :]
    first = rows[0][0] if rows else ""
    if first == "Format Version":
        return _motive(path, rows)
    if (names := _row_that_starts(rows, "marker_names", 50)) is not None:
        return _qualisys(path, rows, names)
    trajectories = _row_that_starts(rows, "trajectories", len(rows))
    if first == "PathFileType" or trajectories is not None:
        return _stacked(path, rows, trajectories)
    return _stacked(path, rows, None) if _axis_row(rows, 0, 10) is not None else _plain(path, rows)


def number(cell: str) -> float:
    """What a cell holds, NaN where it says that nothing is there; commas for decimal points are understood.

    Raises:
        ValueError: it is no number.
    """
    if cell.lower() in _MISSING:
        return np.nan
    return float(cell.replace(",", ".") if cell.count(",") == 1 and "." not in cell else cell)


def _row_that_starts(rows: Rows, word: str, within: int) -> int | None:
    return next((i for i, row in enumerate(rows[:within]) if row and row[0].lower() == word), None)


def _axis_row(rows: Rows, start: int, within: int) -> int | None:
    """The first row that has X, Y, Z side by side."""
    return next((i for i, row in enumerate(rows[start : start + within], start) if _triplets(row)), None)


def _triplets(row: Sequence[str]) -> list[int]:
    """Columns in which X, Y, Z start."""
    axes = [match[1].upper() if (match := _AXIS.fullmatch(cell)) else "" for cell in row]
    return [i for i in range(len(axes) - 2) if axes[i : i + 3] == ["X", "Y", "Z"]]


def _positive(*cells: str | None) -> float | None:
    """The first of the cells that holds a positive number."""
    for cell in cells:
        if cell and not _is_word(cell) and number(cell) > 0:
            return number(cell)
    return None


def _stacked(path: object, rows: Rows, trajectories: int | None) -> Table:
    """Labels in a row, axes in the next one: .trc, Vicon, and tables with these two rows."""
    start = 0 if trajectories is None else trajectories
    at = _axis_row(rows, start, 10)
    if at is None or at == 0:
        raise UserError(f"{path} is cut off within its header: export it again.")
    columns, names = _triplets(rows[at]), rows[at - 1]
    for i, cell in enumerate(names[columns[0] :], columns[0]):
        if cell and (i not in columns or cell.lower().startswith(("frame", "time"))):
            raise UserError(f"{path}: the label {cell} does not stand above an X, Y, Z of its own: export it again.")
    labels = [names[i] if i < len(names) else "" for i in columns]
    facts, rate = {}, None
    if rows[0][0] == "PathFileType":
        facts = dict(zip(rows[1], rows[2], strict=False))
        rate = _positive(facts.get("DataRate"), facts.get("CameraRate"))
    elif trajectories is not None:
        rate = _positive(*rows[start + 1][:1])
    unit, body = facts.get("Units", ""), at + 1
    below = rows[body] if body < len(rows) else []
    if any(_is_word(below[i]) for i in columns if i < len(below)):  # a row of units
        unit, body = next(below[i] for i in columns if i < len(below) and _is_word(below[i])), body + 1
    head = [*names, *[""] * len(rows[at])]
    return _table(
        rows, body, labels, columns, len(rows[at]), ends=trajectories is not None,
        rate=rate, unit=unit, announced=_whole(facts.get("NumFrames")),
        frame=_column(head, rows[at], "frame"), time=_column(head, rows[at], "time"),
    )  # fmt: skip


def _motive(path: object, rows: Rows) -> Table:
    facts = dict(zip(rows[0][0::2], rows[0][1::2], strict=False))
    at = _axis_row(rows, 1, 10)
    by_kind = {row[1].lower(): row for row in rows[1 : at or 0] if len(row) > 1 and row[1]}
    if at is None or not {"type", "name"} <= by_kind.keys():
        raise UserError(f"{path} lacks the rows Type, Name and X, Y, Z of Motive's tables: export it again.")
    types, names, what = by_kind["type"], by_kind["name"], rows[at - 1]
    positions = [i for i in _triplets(rows[at]) if i < min(map(len, (types, names, what))) and what[i] == "Position"]
    found = ([i for i in positions if types[i].lower() in kinds] for kinds in _MOTIVE_TYPES)
    columns = next(filter(None, found), [])
    if not columns:
        raise UserError(f"{path} has no columns of markers, but {', '.join(sorted({*types[2:]} - {''}))}: export them.")
    return _table(
        rows, at + 1, [names[i] for i in columns], columns, len(rows[at]),
        rate=_positive(facts.get("Export Frame Rate"), facts.get("Capture Frame Rate")),
        unit=facts.get("Length Units", ""), announced=_whole(facts.get("Total Exported Frames")), frame=0, time=1,
    )  # fmt: skip


def _qualisys(path: object, rows: Rows, names: int) -> Table:
    facts = {row[0].upper(): row[1] for row in rows[:names] if len(row) > 1}
    labels = [label for label in rows[names][1:] if label]
    start = names + 1
    while start < len(rows) and not _is_frame(rows[start]):
        start += 1
    # Frame and Time are there or not: the first counts, the second grows.
    few = [row for row in rows[start : start + 3] if any(row)]
    width, counted = 3 * len(labels), _grows(few, 0) and all(row[0].isdigit() for row in few)
    first = 0 if not counted else 2 if _grows(few, 1) and max(map(len, few)) >= width + 2 else 1
    return _table(
        rows, start, labels, range(first, first + width, 3), first + width,
        rate=_positive(facts.get("FREQUENCY")), unit="mm", announced=_whole(facts.get("NO_OF_FRAMES")),
        frame=0 if first else None, time=1 if first == 2 else None,
    )  # fmt: skip


def _plain(path: object, rows: Rows) -> Table | None:
    header = rows[0] if rows else []
    matches = [(i, match) for i, cell in enumerate(header) if (match := _COORDINATE.fullmatch(cell))]
    axes_of: dict[str, set[str]] = {}
    for _, match in matches:
        axes_of.setdefault(match["label"], set()).add(match["axis"].lower())
    found = [(i, match) for i, match in matches if len(axes_of[match["label"]]) == 3]  # not Index, which ends in x
    if not found:
        return None
    triplets = [found[i : i + 3] for i in range(0, len(found), 3)]
    for three in triplets:
        axes = "".join(match["axis"].lower() for _, match in three)
        columns, labels = [i for i, _ in three], {match["label"] for _, match in three}
        if axes != "xyz" or len(labels) > 1 or columns != list(range(columns[0], columns[0] + 3)):
            raise UserError(f"{path}: its columns must come as x, y, z of one marker after the other.")
    columns = [three[0][0] for three in triplets]
    return _table(
        rows, 1, [three[0][1]["label"] for three in triplets], columns, len(header),
        frame=_column(header, [], "frame"), time=_column(header, [], "time"),
    )  # fmt: skip


def _table(
    rows: Rows, start: int, labels: Sequence[str], columns: Sequence[int], width: int, ends: bool = False, **facts
) -> Table:
    """A table whose frames start in a row; `ends` where it is followed by others after an empty row."""
    while start < len(rows) and not any(rows[start]):
        start += 1
    body = rows[start:]
    if ends and (last := next((i for i, row in enumerate(body) if not any(row)), None)) is not None:
        body = body[:last]
    return Table(labels, columns, [row for row in body if any(row)], width, **facts)


def _column(names: Sequence[str], others: Sequence[str], word: str) -> int | None:
    """The column that either of two rows of the header calls so."""
    found = (i for row in (names, others) for i, cell in enumerate(row) if cell.lower().startswith(word))
    return next(found, None)


def _whole(cell: str | None) -> int | None:
    value = _positive(cell)
    return None if value is None else int(value)


def _is_word(cell: str) -> bool:
    try:
        number(cell)
    except ValueError:
        return True
    return False


def _is_frame(row: Sequence[str]) -> bool:
    return any(row) and not any(map(_is_word, row))


def _grows(rows: Rows, column: int) -> bool:
    values = [number(row[column]) if column < len(row) else np.nan for row in rows]
    return len(values) > 1 and bool((np.diff(values) > 0).all())
