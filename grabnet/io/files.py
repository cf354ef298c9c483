"""Writing files so that a reader never sees half of one, and telling files apart by content."""

from __future__ import annotations

import errno
import hashlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from grabnet.errors import UserError
from grabnet.io.litter import clear_litter, temporary_beside

# What a disk says that takes no more, and a place where nothing can be made.
DISK_ERRORS = {
    *(errno.ENOSPC, errno.EDQUOT, errno.EFBIG),
    *(errno.EROFS, errno.EACCES, errno.EPERM, errno.ENOTDIR, errno.ENOENT),
}


@contextmanager
def naming(path: str | Path, temporary: Path | None = None) -> Iterator[None]:
    """Have what the system refuses in the block name `path` where it names nothing, as a full disk does.

    Args:
        temporary: how the paths begin that stand for `path` until it is complete, which are named so, too.
    """
    try:
        yield
    except OSError as error:
        named = None if error.filename is None else os.fsdecode(error.filename)
        if named is None or (temporary is not None and named.startswith(str(temporary))):
            error.filename = str(path)
        raise


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A temporary path beside `path`, moved over it when the block ends well and removed when it does not.

    The temporary name keeps the suffix, since many writers choose the format by it.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with naming(path, path.parent / f".{path.stem}-"), temporary_beside(path) as temporary:
        yield temporary
        # Temporary files are private; what we publish follows the user's umask like any other file.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)


@contextmanager
def filling(folder: str | Path, names: Sequence[str], is_ours: Callable[[Path], bool]) -> Iterator[Path]:
    """A temporary folder beside `folder`; the files in it move there when the block ends well.

    Earlier files of these names give way; everything else in `folder` stays. Those of the last name are removed first
    and moved last: where they lie, the others are complete and belong to them.

    Args:
        folder: made when needed.
        names: of all files that the block may write, relative to the folder, as patterns: `meshes/hand_*.ply`.
        is_ours: whether the folder holds earlier results.

    Raises:
        UserError: files of these names in a folder that holds no earlier results.
    """
    folder = Path(folder)
    if (there := _named(folder, names)) and not is_ours(folder):
        raise UserError(f"{there[0]} is not of earlier results: move it, or choose another folder.")
    folder.parent.mkdir(parents=True, exist_ok=True)
    clear_litter(folder.parent, folder.name, contents=names)
    with naming(folder, folder.parent / f".{folder.stem}-"), temporary_beside(folder, is_folder=True) as temporary:
        yield temporary
        folder.mkdir(exist_ok=True)
        earlier = [path for path in _named(folder, names) if path.is_file() or path.is_symlink()]
        for path in reversed(earlier):
            path.unlink()
        for within in {path.parent for path in earlier} - {folder}:
            if not any(within.iterdir()):
                within.rmdir()
        for path in _named(temporary, names):
            place = folder / path.relative_to(temporary)
            place.parent.mkdir(exist_ok=True)
            path.replace(place)


def _named(folder: Path, patterns: Sequence[str]) -> list[Path]:
    """Files in a folder in the order of the patterns that they match."""
    return [path for pattern in patterns for path in sorted(folder.glob(pattern))]


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write bytes atomically.

    Tensors, too, are made bytes first, by safetensors' `save`: of a full disk its `save_file` makes no OSError.
    """
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def write_json(path: str | Path, value: Any) -> None:
    """Write `value` as indented JSON, atomically."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(value, indent=2) + "\n", encoding="utf-8")


def sha256(*parts: bytes | str | np.ndarray | Path) -> str:
    """Hex digest of all parts in order; a `Path` stands for its file's bytes, an array for dtype, shape and values."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, Path):
            with part.open("rb") as file:
                while block := file.read(1 << 20):
                    digest.update(block)
        elif isinstance(part, np.ndarray):
            digest.update(f"{part.dtype.str}{part.shape}".encode())
            digest.update(np.ascontiguousarray(part).tobytes())
        else:
            digest.update(part.encode() if isinstance(part, str) else part)
    return digest.hexdigest()


def existing(path: str | Path, what: str) -> Path:
    """`path` when it exists; otherwise a `UserError` that lists what lies beside it."""
    path = Path(path)
    try:
        if path.exists():
            return path
        has_folder = (parent := path.parent).is_dir()
    except (OSError, ValueError) as error:  # a name too long, a folder that must not be entered, a NUL
        raise UserError(f"{what} {path} cannot be opened ({getattr(error, 'strerror', error)}).") from None
    if not has_folder:
        raise UserError(f"{what} {path} does not exist, nor does its folder {parent}.")
    beside = sorted(p.name for p in parent.iterdir() if not p.name.startswith("."))
    listing = ", ".join(beside[:12]) + (", …" if len(beside) > 12 else "")
    raise UserError(f"{what} {path} does not exist; {parent} holds {listing or 'nothing'}.")


def existing_file(path: str | Path, what: str, max_bytes: int | None = None) -> Path:
    """`path` when it is a regular file of at most `max_bytes`: no folder, and no pipe or device, which may never end.

    Raises:
        UserError: it is not.
    """
    path = existing(path, what)
    if not path.is_file():
        raise UserError(f"{what} {path} is no regular file: name the file itself.")
    if max_bytes is not None and (size := path.stat().st_size) > max_bytes:
        raise UserError(f"{what} {path} has {size:,} bytes; at most {max_bytes:,} are read.")
    return path
