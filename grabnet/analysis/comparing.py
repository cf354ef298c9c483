"""What is compared with what."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from grabnet.analysis.data_set import Surface
from grabnet.analysis.statistic import Row
from grabnet.geometry.mesh import Mesh

Item = TypeVar("Item")


def compared(items: Sequence[Item], named: Callable[[Item], tuple[str, str]]) -> list[tuple[Item, Item]]:
    """Pairs to subtract: "use" and each other intent of its data set, then the first data set and each other one.

    Args:
        items: to choose from.
        named: data set and intent of an item; the intent "all" stands for the data set.
    """
    uses = [item for item in items if named(item)[1] == "use"]
    pairs = [
        (use, other)
        for use in uses
        for other in items
        if named(other)[0] == named(use)[0] and named(other)[1] not in ("use", "all")
    ]
    alls = [item for item in items if named(item)[1] == "all"]
    return pairs + [(alls[0], other) for other in alls[1:]]


def is_alike(one: Mesh | Surface, other: Mesh | Surface) -> bool:
    """Whether vertices of one number are of one place: as many, and joined by the same faces."""
    return len(one.vertices) == len(other.vertices) and np.array_equal(one.faces, other.faces)


def minus(one: tuple[str, str], other: tuple[str, str]) -> str:
    """Words for a pair, each of a data set and an intent: "grab, use − pass"."""
    return f"{one[0]}, {one[1]} − {other[1]}" if one[0] == other[0] else f"{one[0]} − {other[0]}, {one[1]}"


def difference(rows: Sequence[Row], others: Sequence[Row]) -> list[Row]:
    """Lines of two tables that agree in their texts: the numbers of `rows` less those of `others`."""
    there = {_key(row): row for row in others}
    return [
        {name: _less(value, there[_key(row)][name]) for name, value in row.items()}
        for row in rows
        if _key(row) in there
    ]


def _less(value: Any, other: Any) -> Any:
    """A difference of numbers; a text stays, and what is unknown of either."""
    return value if isinstance(value, str) else None if value is None or other is None else value - other


def _key(row: Row) -> tuple[str, ...]:
    return tuple(value for value in row.values() if isinstance(value, str))
