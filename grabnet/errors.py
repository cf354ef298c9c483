"""The one error that a user is meant to read, and what is said of any other."""

from __future__ import annotations

import unicodedata

# Characters that a sentence may have; a longer one quotes a value of any size, and loses its middle.
_LONGEST = 4000
# Controls, among them those that terminals obey, and characters that turn the direction of text; lone surrogates and
# separators of lines.
_UNPRINTABLE = {"Cc", "Cs", "Zl", "Zp"}
_TURNING = set("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")


class UserError(ValueError):
    """Bad input, reported in one sentence that names the file, the value and the remedy.

    Commands print it without a traceback and exit with code 2, or 1 where the rest was done; any other exception is a
    bug of ours. What it quotes of files and names can neither steer a terminal nor fill it (`printable`).
    """

    def __init__(self, sentence: object):
        super().__init__(printable(str(sentence)))


def printable(text: str) -> str:
    """Text of at most 4000 characters in which unprintable ones, line ends among them, are escaped, as in `\\x1b`."""
    if len(text) > _LONGEST:
        text = f"{text[: _LONGEST // 2]} … {text[-_LONGEST // 2 :]}"
    return "".join(char if _is_printable(char) else ascii(char)[1:-1] for char in text)


def _is_printable(char: str) -> bool:
    return unicodedata.category(char) not in _UNPRINTABLE and char not in _TURNING
