"""Headers of numpy's files, read without numpy's own reader, which evaluates them and believes them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import IO, NamedTuple

import numpy as np

_MAGIC = b"\x93NUMPY"
_MAX_HEADER = 10_000  # bytes, as numpy has it
_MAX_DIMS = 32
_DTYPE = re.compile(r"[<>|=]?([?biufcSUO])(\d{0,9})")
_MAX_ITEM = {"f": 8, "c": 16}  # bytes of a number: wider ones differ from machine to machine
_SHAPE = r"\((?:\s*\d{1,18}L?\s*,)*(?:\s*\d{1,18}L?)?\s*\)"
_ITEM = rf"'(descr|fortran_order|shape)'\s*:\s*('[^'\\]*'|True|False|{_SHAPE})"
_HEADER = re.compile(rf"\{{\s*{_ITEM}\s*,\s*{_ITEM}\s*,\s*{_ITEM}\s*,?\s*\}}\s*")


class Header(NamedTuple):
    """What follows a header: an array of this shape and type, first index or last one fastest."""

    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype

    @property
    def n_bytes(self) -> int:
        """That the values take."""
        return math.prod(self.shape) * self.dtype.itemsize


def read_header(stream: IO[bytes], max_bytes: int) -> Header:
    """The header that a stream begins with.

    Args:
        stream: at its start.
        max_bytes: that the array may take.

    Raises:
        ValueError: another format, types other than plain values and objects, or a larger array.
    """
    if stream.read(6) != _MAGIC:
        raise ValueError("no array of numpy's format")
    major = stream.read(2)[:1]
    length = int.from_bytes(stream.read(2 if major == b"\x01" else 4), "little")
    if major not in (b"\x01", b"\x02", b"\x03") or length > _MAX_HEADER:
        raise ValueError("a header of an unknown format")
    found = _HEADER.fullmatch(stream.read(length).decode("latin1"))
    if found is None or len(items := dict(zip(found.groups()[::2], found.groups()[1::2], strict=True))) != 3:
        raise ValueError("a header that is no dict of descr, fortran_order and shape")
    if items["fortran_order"] not in ("True", "False") or "'" not in items["descr"] or "(" not in items["shape"]:
        raise ValueError("a header with values of other kinds")
    shape = tuple(int(n) for n in re.findall(r"\d+", items["shape"]))
    dtype = plain_dtype(items["descr"].strip("'"))
    check_size(shape, dtype, max_bytes)
    return Header(shape, items["fortran_order"] == "True", dtype)


def plain_dtype(code: str) -> np.dtype:
    """The type of a code such as `<f4`: booleans, numbers, text, bytes or objects, none of them empty.

    Raises:
        ValueError: another code.
    """
    found = _DTYPE.fullmatch(code)
    if found is None or (found[1] in "SU" and not int(found[2] or 0)):
        raise ValueError(f"values of type {code[:20]!r}")
    try:
        dtype = np.dtype(code)
    except TypeError:
        raise ValueError(f"values of type {code!r}") from None
    if dtype.itemsize > _MAX_ITEM.get(dtype.kind, dtype.itemsize):
        raise ValueError(f"values of type {code!r}")
    return dtype


def check_size(shape: Sequence[int], dtype: np.dtype, max_bytes: int) -> None:
    """Raise a ValueError for an array larger than allowed.

    An axis of no length counts as one: even an empty array of 10¹² rows is more than one can go through.
    """
    size = math.prod(max(n, 1) for n in shape) * dtype.itemsize
    if len(shape) > _MAX_DIMS or min(shape, default=0) < 0 or size > max_bytes:
        shown = "×".join(map(str, shape[:8])) + ("×…" if len(shape) > 8 else "")
        raise ValueError(f"an array of {shown} values of {dtype.itemsize} bytes; at most {max_bytes:,} bytes are read")


def check_text(array: np.ndarray) -> None:
    """Raise a ValueError for an array of text that holds what is no character, such as half of a pair."""
    if array.dtype.kind == "U" and array.size:
        codes = np.ascontiguousarray(array).reshape(-1).view(np.uint32 if array.dtype.isnative else np.dtype(">u4"))
        if codes.max() > 0x10FFFF or ((codes >= 0xD800) & (codes < 0xE000)).any():
            raise ValueError("text with what is no character")
