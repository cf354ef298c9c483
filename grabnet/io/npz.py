"""Reading numpy's files from anywhere: plain arrays, and arrays of Python objects without running anything."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np

from grabnet.errors import UserError
from grabnet.io.archives import DAMAGE, members_of, opened_archive
from grabnet.io.files import existing_file
from grabnet.io.npy import check_text, read_header
from grabnet.io.pickles import MAX_BYTES, decode_pickle

_MAX_ARRAYS = 1000
_REMEDY = "make or download it again"
_FAULT = "not a readable .npz file", _REMEDY


def read_npz(path: str | Path, max_bytes: int = MAX_BYTES) -> dict[str, Any]:
    """Every array of an `.npz`, in this machine's order of bytes.

    Arrays of Python objects are decoded by `decode_pickle`, and a single object (how numpy stores a dict) comes as
    itself.

    Args:
        path: of the file.
        max_bytes: that the arrays may take together; a small file can be made to unpack to any size.

    Raises:
        UserError: not an npz file, too large unpacked, or it holds objects that are not plain data.
    """
    with opened_archive(path, *_FAULT) as archive:
        return {
            _name(member): _member(archive, member, path, max_bytes)
            for member in members_of(archive, path, _MAX_ARRAYS, max_bytes)
        }


def read_npy(path: str | Path) -> Any:
    """The array of an `.npy` file, or the object that it holds; objects as in `read_npz`.

    Raises:
        UserError: not an npy file, or it holds objects that are not plain data.
    """
    path = existing_file(path, "Array")
    with path.open("rb") as stream:
        return _array(stream, path.stat().st_size, str(path), MAX_BYTES)


def npz_names(path: str | Path) -> list[str]:
    """Names of an `.npz`'s arrays.

    Raises:
        UserError: not an npz file.
    """
    with opened_archive(path, *_FAULT) as archive:
        # Sizes are checked where arrays are read.
        return [_name(member) for member in members_of(archive, path, _MAX_ARRAYS, 1 << 63)]


def npz_rows(path: str | Path, name: str, rows: int) -> Iterator[np.ndarray]:
    """A plain array of an `.npz`, `rows` of its first axis at a time, so that arrays larger than memory can be read.

    Raises:
        UserError: no such archive or array, an array of objects, or rows too large to be read.
    """
    with opened_archive(path, *_FAULT) as archive:
        members = {_name(m): m for m in members_of(archive, path, _MAX_ARRAYS, 1 << 63)}
        if name not in members:
            raise UserError(f"{path} has no array {name}.")
        with archive.open(members[name]) as stream:
            header = read_header(stream, members[name].file_size)
            if header.dtype.hasobject or header.fortran or not header.shape:
                raise UserError(f"{path}: {name} is no plain array of rows.")
            per_row = header._replace(shape=header.shape[1:]).n_bytes
            if rows * per_row > MAX_BYTES:
                raise UserError(
                    f"{path}: {name} has rows of {per_row:,} bytes; at most {MAX_BYTES // rows:,} are read."
                )
            for start in range(0, header.shape[0], rows):
                n = min(rows, header.shape[0] - start)
                part = np.frombuffer(_exactly(stream, n * per_row), header.dtype)
                yield _native(part).reshape(n, *header.shape[1:])


def _name(member: zipfile.ZipInfo) -> str:
    return member.filename.removesuffix(".npy")


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, path: str | Path, max_bytes: int) -> Any:
    with archive.open(member) as stream:
        return _array(stream, member.file_size, f"{path} ({member.filename})", max_bytes)


def _array(stream: IO[bytes], size: int, name: str, max_bytes: int) -> Any:
    """The array of a stream of so many bytes."""
    try:
        header = read_header(stream, max_bytes)
        if header.dtype.hasobject:
            array = decode_pickle(stream.read(), name)
            return array.item() if isinstance(array, np.ndarray) and array.shape == () else array
        if not size - 12_000 <= header.n_bytes <= size:
            raise ValueError(f"an array of {header.n_bytes:,} bytes in {size:,}")
        array = np.frombuffer(_exactly(stream, header.n_bytes), header.dtype)
        if stream.read(1):
            raise ValueError("more bytes than its header says")
        array = _native(array)
        check_text(array)
        return array.reshape(header.shape, order="F" if header.fortran else "C")
    except UserError:
        raise
    except DAMAGE as error:
        raise UserError(f"{name} is not a readable array ({error}): {_REMEDY}.") from None


def _native(array: np.ndarray) -> np.ndarray:
    """In the order of bytes of this machine, which torch takes alone."""
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def _exactly(stream: IO[bytes], n: int) -> bytearray:
    """The next n bytes, in memory that can be written to; more is taken only as far as there are bytes."""
    content = bytearray()
    while len(content) < n and (block := stream.read(min(1 << 24, n - len(content)))):
        content += block
    if len(content) < n:
        raise ValueError(f"{len(content):,} bytes instead of {n:,}")
    return content
