"""STL, ASCII and binary: its triangles."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np

from grabnet.geometry.formats.geometry import FormatError, Geometry
from grabnet.geometry.formats.text import decoded, floats

_HEADER = 84
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# What programs store that write the triangles before they know how many there are.
_UNKNOWN = (0, 0xFFFFFFFF)


# What text does not hold, but the count of triangles and their records do.
_CONTROL = re.compile(r"[\0-\x08\x0e-\x1f\x7f]")
_START = re.compile(r"^[ \t]*solid\b", re.MULTILINE)
# The start or end of a solid with its name, which may hold any word; in a file of one line a facet ends it.
_NAMED = re.compile(r"\b(end ?)?solid\b[^\n]*?(?=\n|\Z|\bfacet\s+(?:normal|outer)\b|\bend ?solid\b)")
_AFTER_VERTEX = (["vertex"], ["endloop"], ["endfacet"], ["end"])


def is_ascii(data: bytes) -> bool:
    """Whether it is the ASCII variant: many binary files begin with "solid", too."""
    return _text(data) is not None


def _text(data: bytes) -> str | None:
    """What the ASCII variant holds from its first "solid" on, in lower case; None of the binary one."""
    beginning = decoded(data[: _HEADER + 10 * _RECORD.itemsize].rstrip(b"\0\x1a \t\r\n"))
    if _fits(data) or _CONTROL.search(beginning, 80):
        return None
    text = decoded(data).lower()
    start = _START.search(text)
    return text[start.start() :] if start and "facet" in text and "vertex" in text else None


def is_binary(data: bytes) -> bool:
    """Whether its length is what the count of its triangles says."""
    return _fits(data)


def _fits(data: bytes) -> bool:
    return len(data) >= _HEADER and len(data) == _HEADER + _RECORD.itemsize * int.from_bytes(data[80:84], "little")


def read(data: bytes) -> Geometry:
    """Every triangle, with corners of its own; bytes after the last one are passed over.

    Raises:
        FormatError: ended early, facets of other than three corners, words for numbers, more triangles than it says.
    """
    corners = _binary(data) if (text := _text(data)) is None else _ascii(text)
    return Geometry(corners.reshape(-1, 3).astype(np.float64), np.arange(corners.size // 3).reshape(-1, 3))


def _binary(data: bytes) -> np.ndarray:
    count, held = int.from_bytes(data[80:_HEADER], "little"), max(0, len(data) - _HEADER) // _RECORD.itemsize
    whole = (len(data) - _HEADER) % _RECORD.itemsize == 0
    if count in _UNKNOWN and held:
        count = held
    if len(data) < _HEADER or count > held:
        raise FormatError(f"it ends before its {count} triangles: export it again")
    if whole and count < held:
        raise FormatError(f"it says {count} triangles and holds {held}: export it again")
    return np.frombuffer(data, _RECORD, count, _HEADER)["corners"]


def _ascii(text: str) -> np.ndarray:
    ends = [bool(found[1]) for found in _NAMED.finditer(text)]
    words = _NAMED.sub(" ", text).split()
    if ends.count(True) < ends.count(False):
        raise FormatError("it ends within a solid: export it again")
    at = [i for i, word in enumerate(words) if word == "vertex"]
    values = floats([word for i in at for word in words[i + 1 : i + 4]], "a vertex")
    if any(words[i + 4 : i + 5] not in _AFTER_VERTEX for i in at):
        raise FormatError("a vertex has other than three coordinates: export it again")
    facets = sum(word == "facet" and before != "end" for before, word in pairwise(["", *words]))
    if len(at) != 3 * facets:
        raise FormatError(f"its {facets} facets have {len(at)} corners, not three each: export it as triangles")
    return values
