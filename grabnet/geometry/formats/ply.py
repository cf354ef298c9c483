"""PLY, the polygon file format of Stanford, ASCII and binary: its vertices, polygons and triangle strips."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

from grabnet.geometry.formats.geometry import FormatError, Geometry, gathered, triangulated
from grabnet.geometry.formats.text import decoded, is_number

_KINDS = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"}
_KINDS |= {"double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
_KINDS |= {"float32": "f4", "float64": "f8", "int64": "i8", "uint64": "u8"}
_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
# What ends the header. After lines that end in a CR alone, a binary body may well start with an LF.
_END = re.compile(rb"(?:(\r\n|\n)|\r)end_header[ \t]*(?(1)(?:\r\n|\n|\r|\Z)|(?:\r|\n|\Z))")
_CORNERS = ("vertex_indices", "vertex_index")


class _Property(NamedTuple):
    name: str
    kind: str
    count: str | None  # kind of a list's length


class _Element(NamedTuple):
    name: str
    number: int
    properties: list[_Property]


class _EndedError(FormatError):
    """A body that is shorter than its elements."""


def read(data: bytes) -> Geometry:
    """Every polygon and strip of the file; other elements, colours and bytes after the last element are passed over.

    Raises:
        FormatError: no PLY header, an unknown kind of number, ended early, words for numbers, no coordinates.
    """
    data = data.removeprefix(b"\xef\xbb\xbf")
    if not data.startswith(b"ply"):
        data = decoded(data).encode("latin-1", "replace")
    lines, body = _header(data)
    order, elements = _parsed(lines)
    if lines[0][1:2] != ["ascii"]:
        return _geometry(body, order, elements)
    words = body.split()
    numbers = _leading_numbers(words)
    eight = [[p._replace(kind="f8", count=p.count and "f8") for p in e.properties] for e in elements]
    elements = [e._replace(properties=p) for e, p in zip(elements, eight, strict=True)]
    try:
        return _geometry(numbers.tobytes(), order, elements)
    except _EndedError:
        if len(numbers) == len(words):
            raise
        raise FormatError("it has words where numbers are due: export it again") from None


def _leading_numbers(words: list[bytes]) -> np.ndarray:
    """(N,) float64 numbers up to the first word that is none."""
    try:
        return np.array(words, np.float64)
    except ValueError:
        return np.array(words[: next(i for i, word in enumerate(words) if not is_number(word, float))], np.float64)


def _geometry(body: bytes, order: str, elements: list[_Element]) -> Geometry:
    """Vertices and triangles of elements whose values follow each other in a body."""
    vertices, counts, corners = np.zeros((0, 3)), [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    at = 0
    for element in elements:
        values, at = _values(body, at, element, order)
        if element.name == "vertex":
            if missing := [axis for axis in "xyz" if axis not in values]:
                raise FormatError(f"its vertices have no {', '.join(missing)}")
            vertices = np.stack([values[axis].astype(np.float64) for axis in "xyz"], 1)
        elif element.name in ("face", "tristrips") and element.number:
            name = next((name for name in _CORNERS if f"{name}#" in values), None)
            if name is None:
                raise FormatError(f"its element {element.name} has no list {_CORNERS[0]}")
            of_each, all_of_them = values[f"{name}#"].astype(np.int64), values[name].astype(np.int64)
            if element.name == "tristrips":
                of_each, all_of_them = gathered(_strips(of_each, all_of_them))
            counts.append(of_each)
            corners.append(all_of_them)
    return triangulated(vertices, np.concatenate(counts), np.concatenate(corners))


def _header(data: bytes) -> tuple[list[list[str]], bytes]:
    """Words of the header's lines after the first, without comments, and what follows it."""
    if not re.match(rb"ply[ \t]*[\r\n]", data):
        raise FormatError("it does not start with ply")
    end = _END.search(data)
    if end is None:
        raise FormatError("its header has no end")
    lines = [line.split() for line in re.split(r"[\r\n]", data[: end.start()].decode("latin-1"))[1:]]
    lines = [words for words in lines if words and words[0] not in ("comment", "obj_info")]
    return lines, data[end.end() :]


def _parsed(lines: list[list[str]]) -> tuple[str, list[_Element]]:
    """The order of bytes, and the elements that the header declares."""
    elements: list[_Element] = []
    if not lines or lines[0][0] != "format" or lines[0][1:2] == [] or lines[0][1] not in _ORDERS:
        raise FormatError(f"its format is none of {', '.join(_ORDERS)}")
    for words in lines[1:]:
        match words:
            case ["element", name, number] if number.isdecimal():
                elements.append(_Element(name, int(number), []))
            case ["property", "list", count, kind, name] if elements and {count, kind} <= set(_KINDS):
                elements[-1].properties.append(_Property(name, _KINDS[kind], _KINDS[count]))
            case ["property", kind, name] if elements and kind in _KINDS:
                elements[-1].properties.append(_Property(name, _KINDS[kind], None))
            case _:
                raise FormatError(f"its header has the line {' '.join(words)[:60]!r}")
    return _ORDERS[lines[0][1]], elements


def _values(body: bytes, at: int, element: _Element, order: str) -> tuple[dict[str, np.ndarray], int]:
    """Values of an element that starts at a byte, by name, and where it ends.

    Of a list there are its lengths, as <name>#, and its values one row after the other.
    """
    if not element.number or not element.properties:
        return {}, at
    lengths = _lengths(body, at, element, order)
    row = _row(element, lengths, order)
    if at + row.itemsize * element.number <= len(body):
        rows = np.frombuffer(body, row, element.number, at)
        if all((rows[f"{name}#"] == length).all() for name, length in lengths.items()):
            values = {name: rows[name].reshape(-1) if name in lengths else rows[name] for name in row.names or ()}
            return values, at + row.itemsize * element.number
    return _uneven(body, at, element, order)


def _row(element: _Element, lengths: dict[str, int], order: str) -> np.dtype:
    """A row of an element whose lists have these lengths."""
    fields: list[tuple] = []
    for p in element.properties:
        if p.count is None:
            fields.append((p.name, order + p.kind))
        else:
            fields += [(f"{p.name}#", order + p.count), (p.name, order + p.kind, (lengths[p.name],))]
    try:
        return np.dtype(fields)
    except ValueError:
        raise FormatError(f"its element {element.name} has two properties of one name") from None


def _lengths(body: bytes, at: int, element: _Element, order: str) -> dict[str, int]:
    """Lengths of the lists of the row that starts at a byte."""
    lengths = {}
    for p in element.properties:
        if p.count is not None:
            kind = np.dtype(order + p.count)
            _check_within(body, at + kind.itemsize, element)
            lengths[p.name] = int(np.frombuffer(body, kind, 1, at)[0])
            at += kind.itemsize
            if lengths[p.name] < 0:
                raise FormatError(f"its element {element.name} has a list of length {lengths[p.name]}")
        at += np.dtype(p.kind).itemsize * lengths.get(p.name, 1)
        _check_within(body, at, element)
    return lengths


def _uneven(body: bytes, at: int, element: _Element, order: str) -> tuple[dict[str, np.ndarray], int]:
    """As `_values`, where lists differ in length from row to row: row by row."""
    parts: dict[str, list[np.ndarray]] = {}
    rows: dict[tuple[int, ...], np.dtype] = {}
    for _ in range(element.number):
        lengths = _lengths(body, at, element, order)
        key = tuple(lengths.values())
        if key not in rows:
            rows[key] = _row(element, lengths, order)
        values = np.frombuffer(body, rows[key], 1, at)[0]
        at += rows[key].itemsize
        for name in rows[key].names or ():
            parts.setdefault(name, []).append(values[name])
    return {name: np.concatenate([np.ravel(x) for x in found]) for name, found in parts.items()}, at


def _check_within(body: bytes, end: int, element: _Element) -> None:
    if end > len(body):
        raise _EndedError(f"it ends before its {element.number} of {element.name}: export it again")


def _strips(counts: np.ndarray, corners: np.ndarray) -> list[list[int]]:
    """Triangles of strips, which -1 ends and starts again; every other one is turned round."""
    triangles = []
    for strip in np.split(corners, np.cumsum(counts)[:-1]):
        for part in np.split(strip, np.flatnonzero(strip == -1)):
            part = part[part >= 0].tolist()
            for i in range(len(part) - 2):
                a, b, c = part[i : i + 3]
                triangles.append([a, b, c] if i % 2 == 0 else [b, a, c])
    return triangles
