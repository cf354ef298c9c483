"""Wavefront OBJ: its vertices and polygons."""

from __future__ import annotations

import re

import numpy as np

from grabnet.geometry.formats.geometry import FormatError, Geometry, triangulated, whole_numbers
from grabnet.geometry.formats.text import decoded, floats, integers

_COMMENT = re.compile(r"#[^\n]*")  # taken out first: one that ends in a backslash does not go on
_BREAK = re.compile(r"\\[ \t]*\n")
# Statements of numbers that go on below; a name or path may end in a backslash.
_CONTINUED = re.compile(r"^[ \t]*(?:v[nt]?|fo?|l|p)(?=[ \t\\])(?:[^\n]*\\[ \t]*\n)+", re.MULTILINE)
# Statements that make or fetch surfaces which are neither vertices nor polygons.
_NOT_READ = {"surf", "curv", "bzp", "bsp", "cdc", "cdp", "res", "call"}


def read(data: bytes) -> Geometry:
    """Every polygon of the file; groups, lines, points, normals and materials are passed over.

    Raises:
        FormatError: no vertices, words where numbers are due, vertices of fewer than three coordinates, faces that name
            a vertex that is not there, free-form surfaces.
    """
    text = decoded(data)
    if "#" in text:
        text = _COMMENT.sub("", text)
    if "\\" in text:
        text = _CONTINUED.sub(lambda found: _BREAK.sub(" ", found[0]), text)
    coordinates: list[str] = []
    corners: list[int] = []
    counts: list[int] = []
    above: list[int] = []  # vertices above each face, from which numbers below 0 count back
    for line in text.split("\n"):
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            if len(words) < 4:
                number = len(coordinates) // 3 + 1
                raise FormatError(f"vertex {number} has {len(words) - 1} coordinates; a solid needs three")
            coordinates += words[1:4]
        elif words[0] in ("f", "fo"):
            named = [word.split("/", 1)[0] for word in words[1:]] if "/" in line else words[1:]
            corners += integers(named, f"face {len(counts) + 1}")
            counts.append(len(named))
            above.append(len(coordinates) // 3)
        elif words[0] in _NOT_READ:
            raise FormatError(f"the statement {words[0]!r} is not read: export it as polygons")
    if not coordinates:
        raise FormatError("no line starts with v: give it its true extension, or export it again")
    vertices = floats(coordinates, "a vertex").reshape(-1, 3)
    return triangulated(vertices, np.array(counts, np.int64), _from_zero(corners, counts, above))


def _from_zero(corners: list[int], counts: list[int], above: list[int]) -> np.ndarray:
    """(C,) vertex numbers that count from 0."""
    named, so_far = whole_numbers(corners), np.repeat(np.array(above, np.int64), counts)
    numbers = np.where(named > 0, named - 1, named + so_far)
    if len(wrong := np.flatnonzero((named == 0) | (numbers < 0))):
        raise FormatError(f"a face names vertex {named[wrong[0]]}, of {so_far[wrong[0]]} so far: export it again")
    return numbers
