"""Reading marker tables as capture software exports them: .trc, Vicon's .csv, Qualisys' .tsv, and plain ones.

A plain table has a header of columns LABEL_x, LABEL_y, LABEL_z (or LABEL.x …, LABEL:x …), and may have Frame and Time.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from grabnet.errors import UserError
from grabnet.io.files import existing
from grabnet.mosh.markers import MarkerData, markers_of

_COORDINATE = re.compile(r"^(?P<label>.+?)[\s_.:-]*(?P<axis>[xyz])$", re.IGNORECASE)
_Rows = list[list[str]]


@dataclass(frozen=True)
class _Table:
    """labels: one per marker. rows: of text, one a frame. first: column of the first x. rate, unit: as said."""

    labels: Sequence[str]
    rows: _Rows
    first: int
    rate: float | None
    unit: str


def read_table(path: str | Path, unit: str | None = None, up: str = "z", rate: float | None = None) -> MarkerData:
    """Markers of a table, in metres; empty cells, and what is no number, are missing markers.

    Args:
        path: `.trc`, `.tsv` or `.csv` file.
        unit, rate: replace the file's; plain tables need a rate, unless they have a column Time.
        up: the file's vertical axis.

    Raises:
        UserError: an unknown layout of the table, no rate, rows of other lengths than the header; as `markers_of`.
    """
    path = existing(path, "Capture")
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise UserError(f"{path} is no text in UTF-8: export it as text again.") from None
    delimiter = "\t" if "\t" in text[:4000] else ";" if text[:4000].count(";") > text[:4000].count(",") else ","
    rows = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text), delimiter=delimiter)]
    read = next((read for starts, read in _FORMATS if rows and starts(rows)), None)
    if read is None:
        raise UserError(
            f"{path} is no marker table that is known: .trc, Vicon's trajectories, Qualisys' .tsv, or a header of "
            "columns LABEL_x, LABEL_y, LABEL_z."
        )
    table = read(path, rows)
    if not (rate or table.rate):
        raise UserError(f"{path} does not say how many frames it has per second: give rate=.")
    positions = _numbers(path, table)
    return markers_of(path, table.labels, positions, rate or table.rate, table.unit, unit, up=up)


def _numbers(path: Path, table: _Table) -> np.ndarray:
    """(T, M, 3), NaN where there is no number."""
    width = 3 * len(table.labels)
    values = np.full((len(table.rows), width), np.nan)
    for i, row in enumerate(table.rows):
        cells = row[table.first : table.first + width]
        if any(row[table.first + width :]):
            raise UserError(f"{path}: row {i + 1} of the frames has more than {len(table.labels)} markers.")
        values[i, : len(cells)] = [_number(cell) for cell in cells]
    return values.reshape(len(values), -1, 3)


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _frames(rows: _Rows) -> _Rows:
    return [row for row in rows if any(row)]


def _trc(path: Path, rows: _Rows) -> _Table:
    if len(rows) < 5:
        raise UserError(f"{path} is cut off within its header: export it again.")
    facts = dict(zip(rows[1], rows[2], strict=False))
    labels = [label for label in rows[3][2:] if label]
    return _Table(labels, _frames(rows[5:]), 2, _number(facts.get("DataRate", "")) or None, facts.get("Units", ""))


def _vicon(path: Path, rows: _Rows) -> _Table:
    start = next(i for i, row in enumerate(rows) if row and row[0].lower() == "trajectories")
    if len(rows) < start + 5:
        raise UserError(f"{path} is cut off within its header: export it again.")
    labels = [label for label in rows[start + 2][2:] if label]
    units = [unit for unit in rows[start + 4] if unit]
    ends = next((i for i, row in enumerate(rows[start + 5 :]) if not any(row)), None)
    body = rows[start + 5 :] if ends is None else rows[start + 5 : start + 5 + ends]
    return _Table(labels, body, 2, _number(rows[start + 1][0]), units[0] if units else "")


def _qualisys(path: Path, rows: _Rows) -> _Table:
    facts = {row[0].upper(): row[1:] for row in rows if row}
    start = next(i for i, row in enumerate(rows) if row[0].upper() == "MARKER_NAMES") + 1
    labels = [label for label in facts["MARKER_NAMES"] if label]
    while start < len(rows) and not _is_frame(rows[start]):
        start += 1
    body = _frames(rows[start:])
    extra = max((len([c for c in row if c]) for row in body), default=0) - 3 * len(labels)
    return _Table(labels, body, min(max(extra, 0), 2), _number(facts.get("FREQUENCY", [""])[0]), "mm")


def _plain(path: Path, rows: _Rows) -> _Table:
    header = rows[0]
    found = [(i, match) for i, cell in enumerate(header) if (match := _COORDINATE.match(cell))]
    first = found[0][0]
    labels = [match["label"] for _, match in found[::3]]
    expected = [f"{label}{axis}" for label in labels for axis in "xyz"]
    there = [match["label"] + match["axis"].lower() for _, match in found]
    if [i for i, _ in found] != [*range(first, first + len(found))] or there != expected:
        raise UserError(f"{path}: its columns must come as x, y, z of one marker after the other.")
    body = _frames(rows[1:])
    time = next((i for i, cell in enumerate(header[:first]) if cell.lower().startswith("time")), None)
    rate = None
    if time is not None and len(body) > 1:
        lasts = _number(body[-1][time]) - _number(body[0][time])
        rate = (len(body) - 1) / lasts if lasts > 0 else None
    return _Table(labels, body, first, rate, "")


def _is_frame(row: list[str]) -> bool:
    return bool(row) and np.isfinite([_number(cell) for cell in row if cell]).all() and any(row)


_FORMATS = (
    (lambda rows: rows[0] and rows[0][0] == "PathFileType", _trc),
    (lambda rows: any(row and row[0].lower() == "trajectories" for row in rows[:20_000]), _vicon),
    (lambda rows: any(row and row[0].upper() == "MARKER_NAMES" for row in rows[:50]), _qualisys),
    (lambda rows: sum(bool(_COORDINATE.match(cell)) for cell in rows[0]) >= 3, _plain),
)
