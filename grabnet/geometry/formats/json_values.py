"""Values of a glTF document, which may hold anything."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from grabnet.geometry.formats.geometry import FormatError


def items(document: dict, name: str) -> list:
    """The list of a name; empty where there is none.

    Raises:
        FormatError: something else than a list.
    """
    found = document.get(name, [])
    if not isinstance(found, list):
        raise FormatError(f"its {name} are no list: export it again")
    return found


def item(document: dict, name: str, number: Any) -> dict:
    """An object of the list of a name.

    Raises:
        FormatError: it is not there.
    """
    found = items(document, name)
    number = whole(number, f"a number of {name}")
    if number >= len(found) or not isinstance(found[number], dict):
        raise FormatError(f"it refers to number {number} of its {len(found)} {name}: export it again")
    return found[number]


def extensions_of(part: dict, where: str) -> dict:
    """Extensions of a part of a document by name; empty where there are none.

    Raises:
        FormatError: something else than an object.
    """
    found = part.get("extensions") or {}
    if not isinstance(found, dict):
        raise FormatError(f"the extensions of {where} are damaged: export it again")
    return found


def whole(value: Any, what: str) -> int:
    """A whole number, not below 0.

    Raises:
        FormatError: it is none.
    """
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**53:
        raise FormatError(f"{what} is {value!s:.20}: export it again")
    return value


def array(value: Any, size: int, what: str) -> np.ndarray:
    """(size,) finite numbers.

    Raises:
        FormatError: others.
    """
    numbers = isinstance(value, list) and all(isinstance(x, int | float) and abs(x) < 1e300 for x in value)
    if not numbers or len(value) != size or not all(map(math.isfinite, value)):
        raise FormatError(f"{what} is not {size} finite numbers: export it again")
    return np.array(value, np.float64)
