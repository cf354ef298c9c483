"""Reading checkpoints of torch that may be damaged or another's: looked through before torch's own reader has them.

That reader runs no code of a file, but believes what it says of sizes, and never ends with what is shared too often.
"""

from __future__ import annotations

import io
import pickle
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import torch
from torch import Tensor

from grabnet.errors import UserError
from grabnet.io.archives import members_of
from grabnet.io.files import existing_file
from grabnet.io.unpickling import MAX_DEPTH, Inert, Reader, RefusedError

_MAX_BYTES = 16 << 30
_MAX_PICKLE = 64 << 20
_MAX_MEMBERS = 100_000
# Bytes that the type of a storage tells; that of others is 1.
_WIDTHS = {"DoubleStorage": 8, "LongStorage": 8, "FloatStorage": 4, "IntStorage": 4, "HalfStorage": 2}
_WIDTHS |= {"BFloat16Storage": 2, "ShortStorage": 2, "ComplexFloatStorage": 8, "ComplexDoubleStorage": 16}


def read_checkpoint(path: str | Path, what: str, remedy: str) -> Any:
    """What `torch.save` wrote: tensors, all on the CPU and whole, and plain containers.

    Args:
        path: of the file.
        what: it is, as in "Checkpoint".
        remedy: what to do about a damaged one; ends the sentence.

    Raises:
        UserError: missing, damaged, holding other objects, or sizes that it does not have.
    """
    path = existing_file(path, what, _MAX_BYTES)
    try:
        _look_through(path)
        content = torch.load(path, map_location="cpu", weights_only=True)
        _check_values(content)
    except OSError as error:
        raise UserError(f"{what} {path} cannot be read ({error.strerror or error}): {remedy}.") from None
    except RefusedError as refused:
        raise UserError(f"{what} {path} cannot be read (it holds a pickled {refused}): {remedy}.") from None
    except Exception as error:  # torch raises many kinds for a damaged file
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise UserError(f"{what} {path} cannot be read ({reason}): {remedy}.") from None
    return content


class _Structure(Reader):
    """Runs a pickle of torch's into stand-ins, and notes how many bytes its storages are said to have."""

    def __init__(self, stream: IO[bytes], size: int):
        super().__init__(stream, size, {("collections", "OrderedDict"): _Items})
        self.storages: dict[str, int] = {}

    def find_class(self, module: str, name: str) -> Any:
        if module.split(".")[0] not in ("torch", "collections", "_codecs", "builtins", "__builtin__"):
            raise RefusedError(f"{module}.{name}")
        return self._stands_for.get((module, name)) or type(name, (_Anything,), {})

    def persistent_load(self, pid: Any) -> Any:
        kind, storage, key, _, n, *_ = pid
        if kind != "storage" or type(n) is not int or n < 0:
            raise pickle.UnpicklingError("a storage of no size")
        self.storages[str(key)] = n * _WIDTHS.get(getattr(storage, "__name__", ""), 1)
        return None


class _Anything(Inert):
    """Whatever a pickle makes or names; torch's reader decides what it may be."""


class _Items(_Anything):
    """`collections.OrderedDict`."""

    def __setitem__(self, key: Any, value: Any) -> None:
        hash(key)


def _look_through(path: Path) -> None:
    """Raise for pickles that are too deep or make too much work, or storages that aren't in the file."""
    if not zipfile.is_zipfile(path):
        return _look_through_legacy(path)
    with zipfile.ZipFile(path) as archive:
        members = members_of(archive, path, _MAX_MEMBERS, _MAX_BYTES)
        sizes = {member.filename.rpartition("/data/")[2]: member.file_size for member in members}
        pickles = [member for member in members if member.filename.endswith("/data.pkl")]
        if len(pickles) != 1 or pickles[0].file_size > _MAX_PICKLE:
            raise ValueError("no checkpoint of torch's")
        content = archive.read(pickles[0])
    structure = _Structure(io.BytesIO(content), len(content))
    structure.load()
    if missing := [key for key, size in structure.storages.items() if sizes.get(key, -1) < size]:
        raise ValueError(f"its storage {missing[0]} has not as many bytes as it says")


def _look_through_legacy(path: Path) -> None:
    """As `_look_through`, of files that torch wrote before 1.6: five pickles, then the storages."""
    size = path.stat().st_size
    with path.open("rb") as file:
        for number in range(5):
            structure = _Structure(file, min(size, _MAX_PICKLE))
            structure.load()
            if number == 3 and sum(structure.storages.values()) > size:
                raise ValueError("its storages have not as many bytes as it says")


def _check_values(content: Any) -> None:
    """Raise a ValueError for tensors that take no memory for each element, or nesting that is too deep."""
    for value in _parts(content, 0, set()):
        if isinstance(value, Tensor):
            if value.layout != torch.strided or value.is_quantized:
                raise ValueError("a tensor that is not dense")
            if value.nbytes > value.untyped_storage().nbytes() or max(value.shape, default=0) > 1 << 31:
                raise ValueError(f"a tensor of shape {tuple(value.shape)} with fewer values")


def _parts(value: Any, depth: int, seen: set[int]) -> Iterator[Any]:
    if depth > MAX_DEPTH:
        raise ValueError(f"values nested more than {MAX_DEPTH} deep")
    if id(value) in seen:
        return
    seen.add(id(value))
    yield value
    items = value.values() if isinstance(value, Mapping) else value if isinstance(value, list | tuple) else ()
    for item in items:
        yield from _parts(item, depth + 1, seen)
