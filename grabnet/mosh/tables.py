"""Reading marker tables as capture software exports them: .trc, .csv, .tsv; `dialects` knows their headers."""

from __future__ import annotations

import codecs
import csv
from pathlib import Path

import numpy as np

from grabnet.errors import UserError
from grabnet.io.files import existing
from grabnet.mosh.dialects import Rows, Table, number, understood
from grabnet.mosh.markers import MarkerData, markers_of

# Share by which a table's rate and that of its times may differ: times are rounded.
_RATE_TOLERANCE = 0.05


def read_table(path: str | Path, unit: str | None = None, up: str = "z", rate: float | None = None) -> MarkerData:
    """Markers of a table, in metres; empty cells, and those that say that nothing is there, are missing markers.

    Cells are separated by tabs, semicolons or commas; numbers have decimal points or commas.

    Args:
        path: `.trc`, `.tsv` or `.csv` file.
        unit, rate: replace the file's; tables that don't say their rate need one, unless they have a column Time.
            With a rate, the column Time does not count.
        up: the file's vertical axis.

    Raises:
        UserError: no text, or of no dialect that is known; no rate; cut off; rows longer than the header; frames left
            out; a rate that is not that of the column Time; a cell that is no number; as `markers_of`.
    """
    path = existing(path, "Capture")
    text = _text(path)
    table = _table(path, text)
    _refuse_cut_off(path, table, text)
    positions = _positions(path, table)
    times = _times(table) if rate is None else None
    _refuse_gaps(path, table, times, rate)
    rate = rate or table.rate or (None if times is None else _rate(times))
    if not rate:
        raise UserError(f"{path} does not say how many frames it has per second: give reading.rate=120, or what it is.")
    return markers_of(path, table.labels, positions, rate, table.unit, unit, up=up)


def _text(path: Path) -> str:
    """Text in UTF-8 or, with its mark, in UTF-16; what is neither, in the code page of western Europe."""
    data = path.read_bytes()
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = data.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        text = "\0" if wide else data.decode("latin-1")
    if "\0" in text:
        raise UserError(f"{path} is no text: export it as text again.")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _table(path: Path, text: str) -> Table:
    """The text as a table, by whichever of the marks between cells makes one of it."""
    refused = UserError(
        f"{path} is no marker table that is known: .trc, those of Vicon Nexus, OptiTrack Motive and Qualisys, or "
        "columns LABEL_x, LABEL_y, LABEL_z."
    )
    for delimiter in [mark for mark in "\t;," if mark in text[:4000]] or ",":
        try:
            if (table := understood(path, _cells(path, text, delimiter))) is not None:
                return table
        except UserError as error:
            refused = error
    raise refused


def _cells(path: Path, text: str, delimiter: str) -> Rows:
    try:
        rows = csv.reader(text.split("\n"), delimiter=delimiter)
        return [[cell.strip() for cell in row] for row in rows]
    except csv.Error as error:
        raise UserError(f"{path} cannot be read as a table ({error}): export it again.") from None


def _positions(path: Path, table: Table) -> np.ndarray:
    """(T, M, 3), NaN where there is no number."""
    values = np.full((len(table.rows), len(table.columns), 3), np.nan)
    for t, row in enumerate(table.rows):
        if any(row[table.width :]):
            raise UserError(
                f"{path}: frame {t + 1} has {len(row)} cells, its header {table.width}: numbers with decimal commas "
                "need semicolons or tabs between them."
            )
        for m, column in enumerate(table.columns):
            three = row[column : column + 3]
            try:
                values[t, m, : len(three)] = [number(cell) for cell in three]
            except ValueError:
                raise UserError(
                    f"{path}: frame {t + 1} has {', '.join(three)} as the place of {table.labels[m] or 'a marker'}, "
                    "which are no numbers."
                ) from None
    return values


def _refuse_cut_off(path: Path, table: Table, text: str) -> None:
    n, rows = len(table.rows), table.rows
    if table.announced is not None and n < table.announced:
        raise UserError(f"{path} is cut off: it has {n} of the {table.announced} frames that its header announces.")
    if n > 1 and not text.endswith("\n") and len(rows[-1]) < min(len(rows[-2]), table.width):
        raise UserError(f"{path} is cut off within its last frame: copy it again.")


def _refuse_gaps(path: Path, table: Table, times: np.ndarray | None, rate: float | None) -> None:
    """Frames that the table leaves out would make what follows them too early; `times` and given `rate`, if any."""
    if table.frame is not None and len(table.rows) > 2:
        _refuse_gaps_of_numbers(path, table, known=times is not None or rate is not None)
    if times is None:
        return
    steps = np.diff(times)
    usual = np.median(steps)
    if (odd := (steps <= 0) | (abs(steps - usual) > (0.5 + 1e-6) * usual)).any():
        i = int(odd.argmax())
        raise UserError(
            f"{path}: frame {i + 1} of the table is at {times[i]:g} s and the next one at {times[i + 1]:g} s, where "
            f"{usual:.4g} s is usual: export all frames, or give reading.rate= if they are all there."
        )
    if table.rate and abs(table.rate / _rate(times) - 1) > _RATE_TOLERANCE:
        raise UserError(
            f"{path} says that it has {table.rate:g} frames per second, and has {_rate(times):.4g} by its column Time: "
            "give the right one as reading.rate=, or export all frames."
        )


def _refuse_gaps_of_numbers(path: Path, table: Table, known: bool) -> None:
    """The same by the frames' numbers; `known` where what they count by does not decide the rate."""
    try:
        numbers = np.array([number(row[table.frame]) for row in table.rows])
    except (ValueError, IndexError):
        raise UserError(f"{path} has frames without a number: export it again.") from None
    steps = np.diff(numbers)
    usual = np.median(steps)
    if usual <= 0 or (steps != usual).any():
        odd = int((steps != max(usual, 1)).argmax())
        raise UserError(
            f"{path}: frame {numbers[odd]:g} is followed by frame {numbers[odd + 1]:g}: export all frames, in order."
        )
    if usual != 1 and not known:
        raise UserError(
            f"{path}: its frames count by {usual:g}, and it has no column Time: give the rate of those that are there "
            "as reading.rate=, or export all frames."
        )


def _times(table: Table) -> np.ndarray | None:
    """(T,) the column Time, in seconds; None without one, or where a frame has none."""
    if table.time is None or len(table.rows) < 2:
        return None
    try:
        times = np.array([number(row[table.time]) for row in table.rows])
    except (ValueError, IndexError):
        return None
    return times if np.isfinite(times).all() else None


def _rate(times: np.ndarray) -> float:
    """Frames per second by times that grow."""
    return float((len(times) - 1) / (times[-1] - times[0]))
