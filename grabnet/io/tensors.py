"""Reading safetensors files that may be damaged or another's: sizes, shapes and numbers are checked before any use."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load
from torch import Tensor

from grabnet.errors import UserError
from grabnet.io.files import existing_file
from grabnet.io.state import Kind, parsed_json

_MAX_BYTES = 4 << 30
_MAX_HEADER = 16 << 20
# Of an axis, also of tensors without elements.
_MAX_LENGTH = 1 << 31
# Sizes of an array's axes; equal letters stand for equal sizes.
Shape = tuple[int | str, ...]


class Tensors(NamedTuple):
    """What a file holds.

    path: of the file. values: tensors by name. facts: texts of the header by name.
    """

    path: Path
    values: dict[str, Tensor]
    facts: dict[str, str]


def read_tensors(path: str | Path, what: str, remedy: str) -> Tensors:
    """Everything in a safetensors file, on the CPU.

    Args:
        path: of the file.
        what: it is, as in "Checkpoint", for messages.
        remedy: what to do about a damaged one; ends the sentence.

    Raises:
        UserError: missing, no regular file, or damaged.
    """
    path = existing_file(path, what, _MAX_BYTES)
    try:
        content = path.read_bytes()
        values, facts = load(content), read_facts(content)
        for name, value in values.items():
            if max(value.shape, default=0) > _MAX_LENGTH:
                raise ValueError(f"{name} has shape {tuple(value.shape)}")
    except (SafetensorError, OSError, KeyError, TypeError, ValueError, RuntimeError, AssertionError) as error:
        reason = " ".join(str(error).split())
        raise UserError(f"{path} is damaged: no readable safetensors file ({reason}); {remedy}.") from None
    return Tensors(path, values, facts)


def header_facts(path: str | Path) -> dict[str, str] | None:
    """The facts of a safetensors file without its tensors; None where it is none."""
    try:
        path = existing_file(path, "File")
        with path.open("rb") as file:
            start = file.read(8)
            length = int.from_bytes(start, "little")
            return read_facts(start + file.read(length)) if length <= _MAX_HEADER else None
    except (OSError, ValueError):
        return None


def read_facts(content: bytes) -> dict[str, str]:
    """Texts that the header of a safetensors file holds beside its tensors.

    Args:
        content: of the file, or its beginning up to the end of the header.

    Raises:
        ValueError: no such header.
    """
    length = int.from_bytes(content[:8], "little")
    if not 0 < length <= min(_MAX_HEADER, len(content) - 8):
        raise ValueError("no header of a safetensors file")
    return parsed_json(content[8 : 8 + length], {"__metadata__?": {str: str}}).get("__metadata__", {})


def fact(tensors: Tensors, name: str, kind: Kind, remedy: str) -> Any:
    """A value of JSON that the header holds as text.

    Raises:
        UserError: it doesn't, or of another kind.
    """
    try:
        return parsed_json(tensors.facts[name], kind)
    except KeyError:
        raise UserError(f"{tensors.path} has no {name} in its header: {remedy}.") from None
    except ValueError as error:
        raise UserError(f"{tensors.path} has a damaged header, where in {name} {error}: {remedy}.") from None


def check_tensors(tensors: Tensors, shapes: Mapping[str, Shape], remedy: str = "") -> None:
    """Raise a `UserError` unless these tensors are there and hold finite numbers in their shapes."""
    ending = f": {remedy}." if remedy else "."
    if missing := [name for name in shapes if name not in tensors.values]:
        raise UserError(f"{tensors.path} lacks {', '.join(missing)}{ending}")
    arrays = {name: tensors.values[name] for name in shapes}
    for name, value in arrays.items():
        if value.is_floating_point():
            arrays[name] = value.float()  # numpy has no bfloat16
        elif value.dtype == torch.bool:
            arrays[name] = value.byte()
    arrays = {name: value.numpy() for name, value in arrays.items()}
    check_shapes(tensors.path, arrays, shapes, ending)


def check_shapes(path: str | Path, arrays: Mapping[str, Any], shapes: Mapping[str, Shape], ending: str = ".") -> None:
    """Raise a `UserError` unless each array holds finite numbers in its shape; equal letters stand for equal sizes."""
    sizes: dict[str, int] = {}
    for name, shape in shapes.items():
        actual = arrays[name].shape
        fits = len(actual) == len(shape) and all(
            n == (sizes.setdefault(s, n) if isinstance(s, str) else s) for s, n in zip(shape, actual, strict=True)
        )
        if not fits:
            expected = tuple(sizes.get(s, s) if isinstance(s, str) else s for s in shape)
            raise UserError(f"{path}: {name} has shape {actual}, expected {expected}{ending}")
        if arrays[name].dtype.kind not in "fiu" or not np.isfinite(arrays[name]).all():
            raise UserError(f"{path}: {name} holds values that are not finite numbers{ending}")
