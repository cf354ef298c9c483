"""Captures on disk, whatever their format."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from grabnet.errors import UserError
from grabnet.io.files import existing
from grabnet.io.names import originals
from grabnet.mosh.c3d import c3d_frames, read_c3d
from grabnet.mosh.markers import MarkerData
from grabnet.mosh.tables import read_table

SUFFIXES = (".c3d", ".trc", ".csv", ".tsv")


def read_capture(path: str | Path, unit: str | None = None, up: str = "z", rate: float | None = None) -> MarkerData:
    """Markers of a file by its suffix, one of `SUFFIXES`; the other arguments as `read_c3d` and `read_table`.

    Raises:
        UserError: another suffix; as the readers.
    """
    path = existing(path, "Capture")
    if path.suffix.lower() not in SUFFIXES:
        raise UserError(f"{path} is no capture: its suffix must be {', '.join(SUFFIXES)}.")
    if path.suffix.lower() != ".c3d":
        return read_table(path, unit, up, rate)
    markers = read_c3d(path, unit, up)
    return markers if rate is None else replace(markers, rate=rate)


def find_captures(place: str | Path) -> list[Path]:
    """The capture that a path is, or all those below a folder, sorted; without hidden files and copies.

    Raises:
        UserError: there is none.
    """
    place = existing(place, "Capture")
    if place.is_file():
        return [place]
    found = originals((p for p in place.rglob("*") if p.suffix.lower() in SUFFIXES and p.is_file()), place)
    if not found:
        raise UserError(f"{place} holds no captures: files that end in {', '.join(SUFFIXES)}.")
    return found


def expected_frames(path: Path) -> int:
    """About how many frames a capture has, without reading it, for progress; at least 1."""
    return max(1, c3d_frames(path) if path.suffix.lower() == ".c3d" else path.read_bytes().count(b"\n"))
