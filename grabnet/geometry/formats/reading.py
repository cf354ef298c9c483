"""A mesh file's geometry, by the reader of its format; files are known by their content, too."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Callable
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from grabnet.errors import UserError
from grabnet.geometry.formats import gltf, obj, off, ply, stl
from grabnet.geometry.formats.geometry import FormatError, Geometry
from grabnet.geometry.formats.text import decoded
from grabnet.io.files import existing

# Bytes of a file, at most: 2 million faces take less in nearly every program's files.
MAX_BYTES = 1 << 29

_READERS: dict[str, Callable[[bytes], Geometry]] = {".obj": obj.read, ".ply": ply.read, ".stl": stl.read}
_READERS |= {".off": off.read}
SUFFIXES = (*_READERS, ".glb", ".gltf")

# Of an address; a single letter is a drive.
_SCHEME = re.compile(r"[a-zA-Z][a-zA-Z\d+.-]+:(?=//?)")
_OBJ_LINES = re.compile(rb"^[ \t]*(v|f)[ \t]+[-+.\d]", re.MULTILINE)
# Content that tells its format; the first that fits counts.
_LOOKS_LIKE: dict[str, Callable[[bytes], object]] = {
    ".glb": lambda data: data.startswith(b"glTF"),
    ".ply": lambda data: decoded(data[:100]).startswith("ply"),
    ".stl": lambda data: stl.is_binary(data) or stl.is_ascii(data),
    ".gltf": lambda data: data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"),
    ".off": lambda data: off.HEADER.match(decoded(data[:100]).lstrip()),
    ".obj": lambda data: {found[1] for found in _OBJ_LINES.finditer(data.replace(b"\r", b"\n"))} == {b"v", b"f"},
}


def read_geometry(path: Path) -> Geometry:
    """Vertices and faces of everything in a file, scenes flattened with their transforms.

    Nothing but geometry is read, and nothing outside the file's own folder.

    Raises:
        UserError: unknown extension, no file that ends, content of another format, unreadable, or no vertices.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise UserError(f"{path} has the extension {suffix or '(none)'}; meshes are read from {', '.join(SUFFIXES)}.")
    data = _bytes(path, str(path))
    if not data.strip():
        raise UserError(f"{path} is empty.")
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused with the mesh
            geometry = _READERS[suffix](data) if suffix in _READERS else gltf.read(data, lambda uri: _buffer(path, uri))
    except (UserError, MemoryError):
        raise
    except Exception as error:  # a broken file can fail anywhere in a parser: all of it means unreadable
        looks_like = next((name for name, test in _LOOKS_LIKE.items() if test(data)), None)
        if looks_like not in (None, suffix) and not {looks_like, suffix} <= {".glb", ".gltf"}:
            raise UserError(
                f"{path} does not hold what its extension {suffix} says: it looks like {looks_like}, rename it."
            ) from None
        reason = str(error) if isinstance(error, FormatError) else "its content is damaged: export it again"
        reason = "".join(c if c.isprintable() else "?" for c in reason)
        raise UserError(f"{path} is not a readable {suffix} file ({reason}).") from None
    if not len(geometry.vertices):
        raise UserError(f"{path} is empty: it holds no vertices.")
    return geometry


def _buffer(path: Path, uri: str) -> bytes:
    """Bytes of a file that a glTF refers to; only files in its own folder or below are touched."""
    folder = path.parent.resolve()
    if scheme := _SCHEME.match(uri):
        raise FormatError(f"it refers to {uri[:60]!r}, and {scheme[0]} addresses are not read: save it as .glb")
    try:
        if not uri.isprintable():
            raise ValueError
        target = (folder / unquote(uri)).resolve()
    except (ValueError, OSError, RuntimeError):  # a NUL within, or links in a circle
        raise FormatError(f"it refers to {uri[:60]!r}, which is no file name: save it as .glb") from None
    if not target.is_relative_to(folder):
        raise UserError(f"{path} refers to {uri[:200]!r}, outside its own folder: save it as .glb, which holds all.")
    try:
        existing(target, f"{path.name} refers to a file that is not there: buffer")
    except OSError as error:
        raise FormatError(f"it refers to {uri[:60]!r}, which cannot be read ({error.strerror})") from None
    return _bytes(target, f"{target}, to which {path.name} refers,")


def _bytes(path: Path, name: str) -> bytes:
    """Content of a file; pipes and devices, which may never end, are refused unread."""
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        try:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe or device"
                raise UserError(f"{name} cannot be read: it is {kind}; name a file.")
            if status.st_size > MAX_BYTES:
                raise UserError(f"{name} has {status.st_size >> 20:,} MB, above {MAX_BYTES >> 20:,} MB: simplify it.")
            with os.fdopen(descriptor, "rb", closefd=False) as file:
                return file.read()
        finally:
            os.close(descriptor)
    except OSError as error:
        raise UserError(f"{name} cannot be read ({error.strerror}).") from None
