"""OFF, the object file format of Geomview: its vertices and polygons."""

from __future__ import annotations

import re

import numpy as np

from grabnet.geometry.formats.geometry import FormatError, Geometry, gathered, triangulated
from grabnet.geometry.formats.text import decoded, numbers

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
        if header[2] or header[3]:
            raise FormatError(f"{header[0].strip()} has other than three coordinates a vertex: export it as OFF")
    plain = header is None or header[0].strip().upper() == "OFF"
    lines = [words for line in text.split("\n") if (words := line.split())]
    if not lines or len(lines[0]) < 2 or not all(word.isdecimal() for word in lines[0][:2]):
        raise FormatError("no numbers of vertices and faces follow its header")
    n_vertices, n_faces = numbers(lines[0][:2], int, "the header")
    rows = lines[1:]
    if plain and len(rows) < n_vertices + n_faces:
        return _unbroken(lines[0][3:] + [word for row in rows for word in row], n_vertices, n_faces)
    if len(rows) < n_vertices + n_faces:
        raise FormatError(f"it ends before its {n_vertices} vertices and {n_faces} faces: export it again")
    vertices = [numbers(row[:3], float, f"vertex {i}") for i, row in enumerate(rows[:n_vertices])]
    if any(len(vertex) < 3 for vertex in vertices):
        raise FormatError("a vertex has fewer than three coordinates: export it again")
    polygons = []
    for i, row in enumerate(rows[n_vertices : n_vertices + n_faces]):
        size = numbers(row[:1], int, f"face {i}")[0]
        if not 0 <= size < len(row):
            raise FormatError(f"face {i} has fewer than its {size} corners: export it again")
        polygons.append(numbers(row[1 : 1 + size], int, f"face {i}"))
    return triangulated(np.array(vertices).reshape(-1, 3), *gathered(polygons))


def _unbroken(words: list[str], n_vertices: int, n_faces: int) -> Geometry:
    """A file without colours whose lines break elsewhere than after each vertex and face."""
    ended = FormatError(f"it ends before its {n_vertices} vertices and {n_faces} faces: export it again")
    if len(words) < 3 * n_vertices:
        raise ended
    vertices = np.array(numbers(words[: 3 * n_vertices], float, "a vertex")).reshape(-1, 3)
    corners = numbers(words[3 * n_vertices :], int, "a face")
    polygons, at = [], 0
    for _ in range(n_faces):
        if at >= len(corners) or not 0 <= corners[at] < len(corners) - at:
            raise ended
        polygons.append(corners[at + 1 : at + 1 + corners[at]])
        at += 1 + corners[at]
    return triangulated(vertices, *gathered(polygons))
