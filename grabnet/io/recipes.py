"""What a thing was begun with, beside what it is to go on with."""

from __future__ import annotations

from typing import Any


def difference(begun: dict[str, Any], now: dict[str, Any]) -> str | None:
    """The first value that differs between two nested dicts, as in "begun with model.width=512, now it is 256"."""
    before, after = _flat(begun), _flat(now)
    changed = [key for key in sorted(before.keys() | after.keys()) if before.get(key) != after.get(key)]
    if not changed:
        return None
    return f"begun with {changed[0]}={before.get(changed[0])}, now it is {after.get(changed[0])}"


def _flat(facts: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested dicts as one, its keys joined by dots."""
    flat = {}
    for key, value in facts.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return flat
