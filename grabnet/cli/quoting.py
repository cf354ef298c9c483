"""File names on Hydra's command line, as people type them."""

from __future__ import annotations

from collections.abc import Sequence

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException


def quoted(arguments: Sequence[str], keys: Sequence[str]) -> list[str]:
    """Command line arguments with the values of `keys` quoted where Hydra's grammar could not read them.

    Hydra refuses many characters that file names have (accents, parentheses, =, ~) unless they are quoted twice, once
    for the shell and once for Hydra. What it takes for a sweep, values with commas, becomes a list.
    """
    return [_quoted(a) if a.partition("=")[0] in keys else a for a in arguments]


def _quoted(argument: str) -> str:
    key, _, value = argument.partition("=")
    try:
        if not OverridesParser.create().parse_override(argument).is_sweep_override():
            return argument
    except HydraException:
        pass
    listed = value.startswith("[") and value.endswith("]")
    items = [item.strip() for item in (value[1:-1] if listed else value).split(",")]
    items = [item if item[:1] in ("'", '"') and item[-1:] == item[:1] else _string(item) for item in items]
    return f"{key}={items[0]}" if len(items) == 1 and not listed else f"{key}=[{','.join(items)}]"


def _string(text: str) -> str:
    """A quoted string of Hydra's grammar: backslashes count only before a quote."""
    trailing = len(text) - len(text.rstrip("\\"))
    return '"' + text.replace('"', '\\"') + "\\" * trailing + '"'
