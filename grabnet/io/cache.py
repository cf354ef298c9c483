"""Keeping on disk what takes long to compute and can be computed again."""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from safetensors import SafetensorError

Value = TypeVar("Value")

# What readers raise for a file that isn't what they should find.
_DAMAGE = (SafetensorError, OSError, KeyError, ValueError, TypeError)


def default_cache() -> Path:
    """Folder for what can be computed again: `$GRABNET_CACHE`, or `grabnet` in the user's cache folder."""
    if chosen := os.environ.get("GRABNET_CACHE"):
        return Path(chosen)
    if folder := os.environ.get("XDG_CACHE_HOME"):
        return Path(folder) / "grabnet"
    try:
        return Path.home() / ".cache" / "grabnet"
    except RuntimeError:  # a user without a home, as in containers
        return Path(tempfile.gettempdir()) / "grabnet"


def load_or_build(
    path: Path, load: Callable[[Path], Value], build: Callable[[], Value], save: Callable[[Value, Path], None]
) -> Value:
    """What `load` reads from `path`; where that isn't there or is damaged, what `build` makes, kept by `save`.

    A damaged file or one that can't be written costs a warning, and time.
    """
    if path.exists():
        try:
            return load(path)
        except _DAMAGE as error:
            warnings.warn(f"The cached {path} is damaged ({error}); it is built anew.", stacklevel=3)
    value = build()
    try:
        save(value, path)
    except OSError as error:
        warnings.warn(f"{path} cannot be written ({error}): it is built anew next time.", stacklevel=3)
    return value
