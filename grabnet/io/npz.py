"""Reading numpy's files from anywhere: plain arrays, and arrays of Python objects without running anything."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np

from grabnet.errors import UserError
from grabnet.io.files import existing
from grabnet.io.pickles import MAX_BYTES, decode_pickle

# What zipfile and numpy raise for files that are not what they should be.
_DAMAGE = (OSError, ValueError, EOFError, KeyError, NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error)


def read_npz(path: str | Path, max_bytes: int = MAX_BYTES) -> dict[str, Any]:
    """Every array of an `.npz`.

    Arrays of Python objects are decoded by `decode_pickle`, and a single object (how numpy stores a dict) comes as
    itself.

    Args:
        max_bytes: that the arrays may take together; a small file can be made to unpack to any size.

    Raises:
        UserError: not an npz file, too large unpacked, or it holds objects that are not plain data.
    """
    path = existing(path, "Archive")
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if (size := sum(m.file_size for m in members)) > max_bytes:
                raise UserError(f"{path} unpacks to {size:,} bytes; at most {max_bytes:,} are read.")
            arrays = {}
            for member in members:
                with archive.open(member) as stream:
                    arrays[member.filename.removesuffix(".npy")] = _array(stream, f"{path} ({member.filename})")
            return arrays
    except UserError:
        raise
    except _DAMAGE as error:
        raise UserError(f"{path} is not a readable .npz file ({error}).") from None


def read_npy(path: str | Path) -> Any:
    """The array of an `.npy` file, or the object that it holds; objects as in `read_npz`.

    Raises:
        UserError: not an npy file, or it holds objects that are not plain data.
    """
    path = existing(path, "Array")
    try:
        with path.open("rb") as stream:
            return _array(stream, str(path))
    except UserError:
        raise
    except _DAMAGE as error:
        raise UserError(f"{path} is not a readable .npy file ({error}).") from None


def npz_names(path: str | Path) -> list[str]:
    """Names of an `.npz`'s arrays.

    Raises:
        UserError: not an npz file.
    """
    path = existing(path, "Archive")
    try:
        with zipfile.ZipFile(path) as archive:
            return [name.removesuffix(".npy") for name in archive.namelist()]
    except _DAMAGE as error:
        raise UserError(f"{path} is not a readable .npz file ({error}).") from None


def npz_rows(path: str | Path, name: str, rows: int) -> Iterator[np.ndarray]:
    """A plain array of an `.npz`, `rows` of its first axis at a time, so that arrays larger than memory can be read.

    Raises:
        UserError: no such archive or array, an array of objects, or rows too large to be read.
    """
    path = existing(path, "Archive")
    try:
        with zipfile.ZipFile(path) as archive, archive.open(f"{name}.npy") as stream:
            shape, fortran, dtype = _header(stream)
            if dtype.hasobject or fortran or not shape:
                raise UserError(f"{path}: {name} is no plain array of rows.")
            per_row = dtype.itemsize * int(np.prod(shape[1:]))
            if rows * per_row > MAX_BYTES:
                raise UserError(
                    f"{path}: {name} has rows of {per_row:,} bytes; at most {MAX_BYTES // rows:,} are read."
                )
            for start in range(0, shape[0], rows):
                n = min(rows, shape[0] - start)
                data = stream.read(n * per_row)
                yield np.frombuffer(data, dtype).reshape(n, *shape[1:])
    except KeyError:
        raise UserError(f"{path} has no array {name}.") from None
    except UserError:
        raise
    except _DAMAGE as error:
        raise UserError(f"{path} is not a readable .npz file ({error}).") from None


def _array(stream: IO[bytes], name: str) -> Any:
    shape, fortran, dtype = _header(stream)
    content = stream.read()
    if dtype.hasobject:
        array = decode_pickle(content, name)
        return array.item() if isinstance(array, np.ndarray) and array.shape == () else array
    # A copy, since what frombuffer gives can't be written to.
    return np.frombuffer(content, dtype, count=int(np.prod(shape))).reshape(shape, order="F" if fortran else "C").copy()


def _header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype]:
    version = np.lib.format.read_magic(stream)
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}.get(version)
    if read is None:
        raise ValueError(f"array format {version}")
    return read(stream)
