"""Recipes: all settings that decide a result, written beside it when it is started, and compared when it continues."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from grabnet.errors import UserError
from grabnet.io.files import write_json
from grabnet.io.state import read_json


def claim(path: Path, recipe: Mapping[str, Any], remedy: str) -> None:
    """Write the recipe of what a folder will hold, or check that a folder started earlier has the same one.

    Args:
        path: file of the recipe, in that folder.
        recipe: JSON-able settings; nested mappings are compared value by value.
        remedy: what the user can do about another recipe; ends the sentence.

    Raises:
        UserError: the folder was started with another recipe, or the file is damaged.
    """
    if not path.exists():
        write_json(path, recipe)
        return
    started = read_json(path, {str: object}, remedy)
    refuse_other(path.parent, started, json.loads(json.dumps(recipe)), remedy)


def refuse_other(what: Path, started: Mapping[str, Any], now: Mapping[str, Any], remedy: str) -> None:
    """Raise a `UserError` that names the first value in which two recipes of `what` differ, and the remedy."""
    before, after = _flat(started), _flat(now)
    for key in sorted(before.keys() | after.keys()):
        if before.get(key) != after.get(key):
            raise UserError(f"{what} was started with {key}={before.get(key)}, now it is {after.get(key)}: {remedy}.")


def _flat(facts: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings as one, its keys joined by dots."""
    flat = {}
    for key, value in facts.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {prefix + key: value}
    return flat
