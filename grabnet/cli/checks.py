"""Numbers and names that a value can have: marks in annotations, which the command line and constructors hold it to.

    def sample(n: Count, seed: Seed, betas: Annotated[list[Annotated[float, Range(-10, 10)]], Filled()] | None): ...

`grabnet.cli.checking` compares a config with the marks of what it configures before anything is built; `in_range` does
so with what a program gives.
"""

from __future__ import annotations

import math
import os
import types
import typing
from collections.abc import Callable, Collection, Sequence, Sized
from dataclasses import dataclass, is_dataclass
from typing import Annotated, Any

from grabnet.errors import UserError


@dataclass(frozen=True)
class Range:
    """Finite numbers from `low` to `high`; `low` itself is not among them where `above`."""

    low: float = -math.inf
    high: float = math.inf
    above: bool = False

    def expected(self, value: object) -> str | None:
        """What "must" hold of the value; None where it does, or where it is no number."""
        if not isinstance(value, int | float) or isinstance(value, bool):
            return None
        if isinstance(value, float) and not math.isfinite(value):
            return "must be a finite number"
        if value > self.high:
            return f"must be at most {self.high}"
        if value < self.low or (self.above and value == self.low):
            return f"must be {'above' if self.above else 'at least'} {self.low}"
        return None


@dataclass(frozen=True)
class Filled:
    """Texts and lists that are not empty."""

    def expected(self, value: object) -> str | None:
        """As that of `Range`, for what can be empty."""
        return "must not be empty" if isinstance(value, Sized) and not len(value) else None


Seed = Annotated[int, Range(0, 2**32 - 1)]  # the bound of numpy's and Lightning's
Count = Annotated[int, Range(1, 1_000_000)]
Several = Annotated[int, Range(2, 1_000_000)]
Batch = Annotated[int, Range(1, 65_536)]  # what is computed, or held in memory, at once
Amount = Annotated[int, Range(0, 1_000_000)]  # a count that may be none
MOST_AT_ONCE = 16 * (os.cpu_count() or 1)
Concurrent = Annotated[int, Range(1, MOST_AT_ONCE)]  # threads or processes; more only cost memory
Distance = Annotated[float, Range(0, 0.1, above=True)]  # m, ε of contact
Positive = Annotated[float, Range(0, above=True)]
Weight = Annotated[float, Range(0)]
Share = Annotated[float, Range(0, 1)]
Name = Annotated[str, Filled()]
Betas = Annotated[Sequence[Annotated[float, Range(-10, 10)]], Filled()]  # standard deviations of the population


def mismatch(value: Any, hint: Any) -> tuple[Any, str] | None:
    """Hold a value to the marks of an annotation.

    Returns:
        None where it is in range, or of another kind than the annotation, which is not looked at here. Otherwise the
        value, or the one of a list, and what must hold of it.
    """
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        if found := mismatch(value, arguments[0]):
            return found
        found = (mark.expected(value) for mark in arguments[1:] if isinstance(mark, Range | Filled))
        return next(((value, words) for words in found if words), None)
    if origin in (typing.Union, types.UnionType):
        return next(filter(None, (mismatch(value, option) for option in arguments)), None)
    if origin in (list, tuple, Sequence) and isinstance(value, Sequence) and not isinstance(value, str):
        return next(filter(None, (mismatch(item, arguments[0]) for item in value)), None)
    return None


def annotations(of: Callable[..., Any]) -> dict[str, Any]:
    """Annotations with their marks of a function's arguments, or of those of a class's constructor.

    Raises:
        NameError, TypeError: annotations that only a type checker can resolve.
    """
    # Of a dataclass those of its fields, each as the module means it where it is written.
    holder = of.__init__ if isinstance(of, type) and not is_dataclass(of) else of
    return typing.get_type_hints(holder, include_extras=True)


def in_range(values: object, where: str = "", /, of: Callable[..., Any] | None = None) -> None:
    """Refuse the first value that is not what its annotation says.

    Args:
        values: its attributes are the values.
        where: the place on the command line, as in "filter.".
        of: the function whose annotations hold; the constructor of `values` when omitted.

    Raises:
        UserError: "n is 0; it must be at least 1."
    """
    for name, hint in annotations(of or type(values)).items():
        if found := mismatch(getattr(values, name, None), hint):
            raise UserError(f"{where}{name} is {found[0]!r}; it {found[1]}.")


def one_of(config: object, where: str = "", /, **options: Collection[object]) -> None:
    """Refuse the first value that is none of its options.

    Args:
        config, where: as in `in_range`.
        options: values that each attribute can have, by name; None among them is printed as null.

    Raises:
        UserError: "hand is 'x'; it can be right, left."
    """
    for name, allowed in options.items():
        if (value := getattr(config, name)) not in allowed:
            listed = ", ".join("null" if option is None else str(option) for option in allowed)
            raise UserError(f"{where}{name} is {value!r}; it can be {listed}.")
