"""Keeping on disk what takes long to compute and can be computed again.

A file of the cache is its content after a line with the SHA-256 of name and content: the name says what it is of, by
hash, so that neither changed bytes nor the file of something else are believed.
"""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from safetensors import SafetensorError

from grabnet.errors import printable
from grabnet.io.files import sha256, write_bytes
from grabnet.io.litter import clear_litter

Value = TypeVar("Value")

_MARK = b"grabnet cache "
_MAX_BYTES = 4 << 30
# What decoders raise for bytes that they do not know.
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
    path: Path, decode: Callable[[bytes], Value], build: Callable[[], Value], encode: Callable[[Value], bytes]
) -> Value:
    """What is kept at `path`; where it isn't there or is damaged, what `build` makes, which is kept.

    A damaged file or one that can't be written costs a warning, and time.

    Args:
        path: whose name holds a hash of all that the value depends on.
        decode: what `encode` made.
        build: makes the value.
        encode: the value as bytes.
    """
    if (value := read_cached(path, decode)) is None:
        value = build()
        write_cached(path, encode(value))
    return value


def read_cached(path: Path, decode: Callable[[bytes], Value]) -> Value | None:
    """What is kept at `path`; None where it isn't there and, with a warning, where it is damaged."""
    try:
        if not path.exists():
            return None
        if not path.is_file() or path.stat().st_size > _MAX_BYTES:
            raise ValueError("no file of a cache")
        line, _, content = path.read_bytes().partition(b"\n")
        if line != _line(path, content):
            raise ValueError("its content is not what was written")
        return decode(content)
    except _DAMAGE as error:
        warnings.warn(printable(f"The cached {path} is damaged ({error}); it is built again."), stacklevel=3)
        return None


def write_cached(path: Path, content: bytes) -> None:
    """Keep the content at `path`; a disk that doesn't take it costs a warning."""
    try:
        clear_litter(path.parent, path.name)
        write_bytes(path, _line(path, content) + b"\n" + content)
    except OSError as error:
        warnings.warn(printable(f"{path} cannot be written ({error}): it is built again next time."), stacklevel=3)


def _line(path: Path, content: bytes) -> bytes:
    return _MARK + sha256(path.name, "\n", content).encode()
