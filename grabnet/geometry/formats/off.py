"""OFF, the object file format of Geomview: its vertices and polygons."""

from __future__ import annotations

import re

from grabnet.geometry.formats.geometry import FormatError, Geometry, gathered, triangulated
from grabnet.geometry.formats.text import decoded, floats, integers

HEADER = re.compile(r"(ST)?C?N?(4?)(n?)OFF(?![a-z])[ \t]*(BINARY)?", re.IGNORECASE)


def read(data: bytes) -> Geometry:
    """Every polygon of the file; colours, normals and texture coordinates are passed over.

    The header may be glued to the counts, in any case, or missing, as Geomview has it.

    Raises:
        FormatError: no OFF file, binary, of other than three dimensions, ended early, or with words for numbers.
    """
    text = "\n".join(line.split("#", 1)[0] for line in decoded(data).split("\n")).lstrip()
    header = HEADER.match(text)
    if header:
        text = text[header.end() :]
        if header[4]:
            raise FormatError("OFF BINARY is not read: export it as ASCII")
        if header[2] or header[3] or "nOFF" in header[0]:  # as it is written; other cases are of normals
            raise FormatError(f"{header[0].strip()} has other than three coordinates a vertex: export it as OFF")
    plain = header is None or header[0].strip().upper() == "OFF"
    lines = [words for line in text.split("\n") if (words := line.split())]
    counts, rows = _counts(lines)
    if len(counts) < 2 or not all(word.isdecimal() for word in counts[:2]):
        raise FormatError("no numbers of vertices and faces follow its header")
    n_vertices, n_faces = integers(counts[:2], "the header")
    if plain and (len(rows) < n_vertices + n_faces or all(len(row) == 1 for row in rows)):
        return _unbroken(counts[3:] + [word for row in rows for word in row], n_vertices, n_faces)
    if len(rows) < n_vertices + n_faces:
        raise FormatError(f"it ends before its {n_vertices} vertices and {n_faces} faces: export it again")
    if any(len(row) < 3 for row in rows[:n_vertices]):
        raise FormatError("a vertex has fewer than three coordinates: export it again")
    vertices = floats([word for row in rows[:n_vertices] for word in row[:3]], "a vertex").reshape(-1, 3)
    polygons = []
    for i, row in enumerate(rows[n_vertices : n_vertices + n_faces]):
        size = integers(row[:1], f"face {i}")[0]
        if not 0 <= size < len(row):
            raise FormatError(f"face {i} has fewer than its {size} corners: export it again")
        polygons.append(integers(row[1 : 1 + size], f"face {i}"))
    return triangulated(vertices, *gathered(polygons))


def _counts(lines: list[list[str]]) -> tuple[list[str], list[list[str]]]:
    """Words of the lines with the numbers of vertices, faces and, often, edges, and the lines that follow."""
    counts, n = [], 0
    while n < len(lines) and (len(counts) < 2 or (len(counts) == 2 and len(lines[n]) == 1)):
        counts += lines[n]
        n += 1
    return counts, lines[n:]


def _unbroken(words: list[str], n_vertices: int, n_faces: int) -> Geometry:
    """A file without colours whose lines break elsewhere than after each vertex and face."""
    ended = FormatError(f"it ends before its {n_vertices} vertices and {n_faces} faces: export it again")
    if len(words) < 3 * n_vertices:
        raise ended
    vertices = floats(words[: 3 * n_vertices], "a vertex").reshape(-1, 3)
    corners = integers(words[3 * n_vertices :], "a face")
    polygons, at = [], 0
    for _ in range(n_faces):
        if at >= len(corners) or not 0 <= corners[at] < len(corners) - at:
            raise ended
        polygons.append(corners[at + 1 : at + 1 + corners[at]])
        at += 1 + corners[at]
    return triangulated(vertices, *gathered(polygons))
