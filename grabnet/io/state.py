"""Reading state files, JSON and YAML, which may be damaged or made by others: checked before anything uses them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig, OmegaConf

from grabnet.errors import UserError
from grabnet.io.files import existing_file

# Bytes of a state file; the largest, the card of a store of thousands of recordings, takes 1 MB.
_MAX_BYTES = 64 << 20
_MAX_YAML = 100_000  # of a run's config, ten times those that there are; YAML is read at 50 kB a second
_MAX_DEPTH = 50
_OPENING = (
    yaml.FlowMappingStartToken, yaml.FlowSequenceStartToken, yaml.BlockMappingStartToken, yaml.BlockSequenceStartToken
)  # fmt: skip
_CLOSING = (yaml.FlowMappingEndToken, yaml.FlowSequenceEndToken, yaml.BlockEndToken)
# A kind is one of
#     str, bool, int (of 64 bits), float (any number), None for null, object for any value of JSON;
#     a set of values, one of which it must be; a tuple of kinds, one of which it must be of;
#     [kind]: a list, each item of that kind; {str: kind}: an object of any keys;
#     {"key": kind, "other?": kind, "*": kind}: an object that has these keys, those with ? not always, and perhaps
#     further ones, which are of the kind of * if it is there.
Kind = Any


class _MismatchError(Exception):
    """Says where a value is not of its kind."""


@dataclass(frozen=True)
class Finite:
    """Kind of numbers that are finite and not below `least`."""

    least: float = -math.inf


def read_json(path: str | Path, kind: Kind, remedy: str) -> Any:
    """The content of a JSON file.

    Args:
        path: of the file.
        kind: of its content, as above.
        remedy: what to do about a file of another content; ends the sentence.

    Raises:
        UserError: missing, unreadable or of another kind; names file, key and value.
    """
    path = existing_file(path, "File", _MAX_BYTES)
    try:
        return parsed_json(path.read_bytes(), kind)
    except (ValueError, OSError) as error:
        raise UserError(f"{path} is damaged ({error}): {remedy}.") from None


def parsed_json(text: str | bytes, kind: Kind) -> Any:
    """A value of JSON.

    Raises:
        ValueError: no JSON, or of another kind.
    """
    try:
        value = json.loads(text)
        _check(value, kind, "", 0)
    except (RecursionError, _MismatchError, UnicodeDecodeError) as error:
        raise ValueError(str(error) if isinstance(error, _MismatchError) else type(error).__name__) from None
    return value


def read_config(path: str | Path, remedy: str) -> DictConfig:
    """A config as it was saved: names and values; interpolations are not resolved.

    Args:
        path: of the file.
        remedy: what to do about a damaged file; ends the sentence.

    Raises:
        UserError: missing, unreadable, or no config.
    """
    path = existing_file(path, "Config", _MAX_YAML)
    try:
        text = path.read_bytes().decode("utf-8")
        _scan(text)
        config = OmegaConf.create(text)
        _check(OmegaConf.to_container(config), {str: object}, "", 0)
    except Exception as error:  # what reads YAML and makes configs of it raises many kinds
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise UserError(f"{path} is damaged, no config ({reason}): {remedy}.") from None
    return config


def _scan(text: str) -> None:
    """Raise a ValueError for YAML with aliases, which make a short file a long config, or nested too deep."""
    depth = 0
    for token in yaml.scan(text, yaml.SafeLoader):
        if isinstance(token, yaml.AliasToken):
            raise ValueError("it has YAML aliases")
        depth += isinstance(token, _OPENING) - isinstance(token, _CLOSING)
        if depth > _MAX_DEPTH:
            raise ValueError(f"it is nested more than {_MAX_DEPTH} deep")


def _check(value: Any, kind: Kind, at: str, depth: int) -> None:
    """Raise a `_MismatchError` for the first value that is not of its kind; `at` is its place."""
    if depth > _MAX_DEPTH:
        raise _MismatchError(f"{at or 'it'} is nested more than {_MAX_DEPTH} deep")
    if isinstance(kind, tuple):
        _check_any(value, kind, at, depth)
    elif isinstance(kind, dict):
        _check_object(value, kind, at, depth)
    elif isinstance(kind, list):
        if not isinstance(value, list):
            raise _mismatch(value, "a list", at)
        for i, item in enumerate(value):
            _check(item, kind[0], f"{at}[{i}]", depth + 1)
    elif kind is object:
        _check_any_value(value, at, depth)
    elif not _is_plain(value, kind):
        raise _mismatch(value, _words(kind), at)


def _check_any(value: Any, kinds: tuple[Kind, ...], at: str, depth: int) -> None:
    for kind in kinds[:-1]:
        try:
            return _check(value, kind, at, depth)
        except _MismatchError:
            continue
    _check(value, kinds[-1], at, depth)


def _check_object(value: Any, kind: Mapping[Any, Kind], at: str, depth: int) -> None:
    if not isinstance(value, dict):
        raise _mismatch(value, "an object", at)
    if str in kind:
        for key, item in value.items():
            _check(key, str, f"a key of {at or 'it'}", depth)
            _check(item, kind[str], f"{at}.{key}" if at else key, depth + 1)
        return
    further = dict.fromkeys(value.keys() - kind.keys(), kind["*"]) if "*" in kind else {}
    for key, of_key in (further | {key: of_key for key, of_key in kind.items() if key != "*"}).items():
        name = key.removesuffix("?")
        place = f"{at}.{name}" if at else name
        if name in value:
            _check(value[name], of_key, place, depth + 1)
        elif not key.endswith("?"):
            raise _MismatchError(f"it has no {place}")


def _check_any_value(value: Any, at: str, depth: int) -> None:
    if isinstance(value, dict):
        _check(value, {str: object}, at, depth)
    elif isinstance(value, list):
        _check(value, [object], at, depth)
    else:
        _check(value, (None, bool, int, float, str), at, depth)


def _is_plain(value: Any, kind: Kind) -> bool:
    if isinstance(kind, set):
        return isinstance(value, str | int) and not isinstance(value, bool) and value in kind
    if isinstance(kind, Finite):
        return _is_number(value) and math.isfinite(value) and value >= kind.least
    if kind is None or kind is bool:
        return value is None if kind is None else isinstance(value, bool)
    if kind is str:
        return isinstance(value, str) and not any("\ud800" <= char <= "\udfff" for char in value)
    return _is_number(value) and (kind is float or isinstance(value, int))


def _is_number(value: Any) -> bool:
    return isinstance(value, float) or (isinstance(value, int) and not isinstance(value, bool) and abs(value) < 1 << 63)


def _mismatch(value: Any, expected: str, at: str) -> _MismatchError:
    shown = json.dumps(value)
    shown = shown if len(shown) <= 80 else f"{shown[:80]}…"
    return _MismatchError(f"{at or 'its content'} is {shown}, expected {expected}")


def _words(kind: Kind) -> str:
    if isinstance(kind, set):
        return " or ".join(map(str, sorted(kind, key=str)))
    if isinstance(kind, Finite):
        return "a finite number" if kind.least == -math.inf else f"a number of at least {kind.least:g}"
    return {str: "text", bool: "true or false", int: "a whole number", float: "a number", None: "null"}[kind]
