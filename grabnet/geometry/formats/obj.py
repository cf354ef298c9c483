"""Wavefront OBJ: its vertices and polygons."""

from __future__ import annotations

import re

import numpy as np

from grabnet.geometry.formats.geometry import FormatError, Geometry, gathered, triangulated
from grabnet.geometry.formats.text import decoded, numbers

_COMMENT = re.compile(r"#[^\n]*")  # taken out first: one that ends in a backslash does not go on
_CONTINUED = re.compile(r"\\[ \t]*\n")
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
        text = _CONTINUED.sub(" ", text)
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    for line in text.split("\n"):
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            vertices.append(numbers(words[1:4], float, f"vertex {len(vertices) + 1}"))
            if len(words) < 4:
                raise FormatError(f"vertex {len(vertices)} has {len(words) - 1} coordinates; a solid needs three")
        elif words[0] in ("f", "fo"):
            where = f"face {len(polygons) + 1}"
            corners = numbers([word.split("/", 1)[0] for word in words[1:]], int, where)
            # Numbers below 0 count back from the last vertex above the face.
            polygons.append([c - 1 if c > 0 else c + len(vertices) for c in corners])
            if 0 in corners or (corners and min(polygons[-1]) < 0):
                raise FormatError(f"{where} names vertex {min(corners)}, of {len(vertices)} so far: export it again")
        elif words[0] in _NOT_READ:
            raise FormatError(f"the statement {words[0]!r} is not read: export it as polygons")
    if not vertices:
        raise FormatError("no line starts with v: give it its true extension, or export it again")
    return triangulated(np.array(vertices), *gathered(polygons))
