"""File names on Hydra's command line, as people type them."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException


def quoted(arguments: Sequence[str], paths: Collection[str], lists: Collection[str] = ()) -> list[str]:
    """Quote file names in command line arguments where Hydra's grammar could not read them, and expand ~.

    Hydra refuses many characters that file names have (accents, parentheses, =, ~) unless they are quoted twice, once
    for the shell and once for Hydra; and it takes values with commas for a sweep.

    Args:
        arguments: the command line without the command.
        paths: config values that are a file name each.
        lists: config values that may be several; what has commas is a list.

    Returns:
        the arguments. With -m or --multirun among them, values with commas stay a sweep.
    """
    sweeps = not {"-m", "--multirun"}.isdisjoint(arguments)
    quoted_ = []
    for argument in arguments:
        key = argument.partition("=")[0].lstrip("+")
        known = "=" in argument and (key in paths or key in lists)
        quoted_.append(_quoted(argument, key in lists, sweeps) if known else argument)
    return quoted_


def _quoted(argument: str, may_be_list: bool, sweeps: bool) -> str:
    key, _, value = argument.partition("=")
    override = _parsed(argument)
    if override is not None and (_is_as_typed(override, may_be_list) or (override.is_sweep_override() and sweeps)):
        return argument
    listed = value.startswith("[") and value.endswith("]") and may_be_list
    if not (may_be_list or sweeps):
        return f"{key}={_item(value)}"
    items = [_item(item.strip()) for item in (value[1:-1] if listed else value).split(",")]
    is_list = listed or (len(items) > 1 and not sweeps)
    return f"{key}=[{','.join(items)}]" if is_list else f"{key}={','.join(items)}"


def _parsed(argument: str) -> Override | None:
    try:
        return OverridesParser.create().parse_override(argument)
    except HydraException:
        return None


def _is_as_typed(override: Override, may_be_list: bool) -> bool:
    """Whether Hydra reads null, a file name, or a list of these or of such lists, without a ~ to expand."""
    if override.is_sweep_override():
        return False
    return _is_name(override.value(), may_be_list)


def _is_name(value: object, may_be_list: bool) -> bool:
    if isinstance(value, list):
        return may_be_list and all(_is_name(item, may_be_list) for item in value)
    return value is None or (isinstance(value, str) and not value.startswith("~"))


def _item(text: str) -> str:
    """A file name as a quoted string of Hydra's grammar, where it is not one already."""
    if text == "null" or (len(text) > 1 and text[0] in ("'", '"') and text[-1] == text[0]):
        return text
    text = os.path.expanduser(text)  # noqa: PTH111, Path would change the rest of the name
    trailing = len(text) - len(text.rstrip("\\"))  # backslashes count only before a quote
    return '"' + text.replace('"', '\\"') + "\\" * trailing + '"'
