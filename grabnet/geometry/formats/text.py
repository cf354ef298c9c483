"""Text of mesh files, whatever program and system wrote it."""

from __future__ import annotations

import codecs

import numpy as np

from grabnet.geometry.formats.geometry import FormatError

_MARKS = {  # UTF-32's first: UTF-16's mark begins it
    codecs.BOM_UTF32_LE: "utf-32-le",
    codecs.BOM_UTF32_BE: "utf-32-be",
    codecs.BOM_UTF8: "utf-8",
    codecs.BOM_UTF16_LE: "utf-16-le",
    codecs.BOM_UTF16_BE: "utf-16-be",
}


def decoded(data: bytes) -> str:
    """Text with lines ended by \\n and without a byte-order mark.

    UTF-16 and UTF-32 are known by their mark, UTF-16 also by its zeros. All else is read as Latin-1, which takes every
    byte: what counts in these formats is ASCII.
    """
    mark, encoding = next(((m, e) for m, e in _MARKS.items() if data.startswith(m)), (b"", "latin-1"))
    if not mark and len(data) > 1 and 0 in data[:2] and any(data[:2]):
        encoding = "utf-16-be" if data[0] == 0 else "utf-16-le"
    text = data[len(mark) :].decode("latin-1" if encoding == "utf-8" else encoding, "replace")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def floats(words: list[str], where: str) -> np.ndarray:
    """(N,) float64 numbers of words.

    Raises:
        FormatError: a word that is none.
    """
    try:
        return np.array(words, np.float64)
    except ValueError:
        word = next(word for word in words if not is_number(word, float))
        raise FormatError(f"{where} has {word[:40]!r} where a number is due: export it again") from None


def integers(words: list[str], where: str) -> list[int]:
    """Words as whole numbers.

    Raises:
        FormatError: a word that is none.
    """
    try:
        return list(map(int, words))
    except ValueError:
        word = next(word for word in words if not is_number(word, int))
        raise FormatError(f"{where} has {word[:40]!r} where a whole number is due: export it again") from None


def is_number(word: str | bytes, kind: type[float] | type[int]) -> bool:
    """Whether a word is a number of a kind."""
    try:
        kind(word)
    except ValueError:
        return False
    return True
