"""Names and texts that files give, checked before they are used in paths, tables and sentences."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from grabnet.errors import UserError, printable

_MAX_PART = 200  # characters of a folder or file


def check_sequence_name(name: str, where: str = "") -> None:
    """Raise a `UserError` for a name of a sequence that is no path of two plain parts.

    Args:
        name: of a sequence.
        where: it stands, as the beginning of a sentence: "store.json: ".
    """
    parts = name.split("/")
    if len(parts) != 2 or not all(is_plain(part) for part in parts):
        raise UserError(f"{where}'{name}' cannot name a sequence: it must be like s1/mug_lift_1.")


def is_plain(name: str) -> bool:
    """Whether a name is that of a file or folder that is neither hidden nor elsewhere."""
    return bool(name.strip()) and name[0] != "." and not set(name) & set("/\\:\0") and len(name) <= _MAX_PART


def read_text(path: Path, name: str, value: Any, longest: int) -> str:
    """A text of a file.

    Args:
        path: of the file. name: of the text in it.
        value: str, bytes, or numpy's array of one.
        longest: characters that it may have.

    Raises:
        UserError: no text, a longer one, or one with characters that cannot be printed.
    """
    array = np.asarray(value)
    if array.dtype.kind not in "US" or array.size != 1:
        raise UserError(f"{path}: {name} is {array.dtype} of shape {array.shape}, expected a text.")
    text = array.item()
    text = text.decode("latin1") if isinstance(text, bytes) else text
    if len(text) > longest or printable(text) != text:
        raise UserError(f"{path}: {name} is {text[:80]!r}; it must be of at most {longest} printable characters.")
    return text
