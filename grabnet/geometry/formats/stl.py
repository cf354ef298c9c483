"""STL, ASCII and binary: its triangles."""

from __future__ import annotations

import numpy as np

from grabnet.geometry.formats.geometry import FormatError, Geometry
from grabnet.geometry.formats.text import decoded, floats

_HEADER = 84
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# What programs store that write the triangles before they know how many there are.
_UNKNOWN = (0, 0xFFFFFFFF)


def is_ascii(data: bytes) -> bool:
    """Whether it is the ASCII variant: many binary files begin with "solid", too."""
    start = data[:3000].replace(b"\0", b"").removeprefix(b"\xef\xbb\xbf").removeprefix(b"\xff\xfe")
    text = start.removeprefix(b"\xfe\xff").lstrip().lower()
    return text.startswith(b"solid") and b"facet" in text and b"vertex" in text and not _fits(data)


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
    corners = _ascii(data) if is_ascii(data) else _binary(data)
    return Geometry(corners.reshape(-1, 3).astype(np.float64), np.arange(corners.size // 3).reshape(-1, 3))


def _binary(data: bytes) -> np.ndarray:
    count, held = int.from_bytes(data[80:_HEADER], "little"), max(0, len(data) - _HEADER) // _RECORD.itemsize
    whole = (len(data) - _HEADER) % _RECORD.itemsize == 0
    if count in _UNKNOWN and held and whole:
        count = held
    if len(data) < _HEADER or count > held:
        raise FormatError(f"it ends before its {count} triangles: export it again")
    if whole and count < held:
        raise FormatError(f"it says {count} triangles and holds {held}: export it again")
    return np.frombuffer(data, _RECORD, count, _HEADER)["corners"]


def _ascii(data: bytes) -> np.ndarray:
    lines = [line.strip() for line in decoded(data).lower().split("\n")]
    corners = [line[6:] for line in lines if line.startswith("vertex")]
    started, ended, facets = (
        sum(line.startswith(key) for line in lines) for key in ("solid", ("endsolid", "end solid"), "facet")
    )
    values = floats(" ".join(corners).split(), "a vertex")
    if ended < started or len(values) != 3 * len(corners):
        raise FormatError("it ends within a solid: export it again")
    if len(corners) != 3 * facets:
        raise FormatError(f"its {facets} facets have {len(corners)} corners, not three each: export it as triangles")
    return values
