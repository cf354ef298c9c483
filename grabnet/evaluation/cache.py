"""Results kept on disk by what they are results of: content, settings, and a number that code changes raise."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from grabnet.files import replacing, sha256

# Part of every key: raise it when the same content and settings would give other results.
FORMAT = 1

Arrays = dict[str, np.ndarray]


class Cache:
    """Arrays in safetensors files of one folder; a damaged or unwritable one costs a warning and time, nothing else.

    Args:
        folder: made when needed.
    """

    def __init__(self, folder: Path):
        self.folder = folder

    def get(self, kind: str, key: Sequence[str | bytes | np.ndarray], compute: Callable[[], Arrays]) -> Arrays:
        """What `compute` gives, computed only where it is not there for this key."""
        path = self.path(kind, key)
        if (found := self.read(path)) is not None:
            return found[0]
        arrays = compute()
        self.write(path, arrays)
        return arrays

    def path(self, kind: str, key: Sequence[str | bytes | np.ndarray]) -> Path:
        """File of a key."""
        return self.folder / f"{kind}-{sha256(str(FORMAT), *map(_framed, key))[:32]}.safetensors"

    def read(self, path: Path) -> tuple[Arrays, list[str]] | None:
        """Arrays and the names of their rows; None where there is no readable file."""
        if not path.exists():
            return None
        try:
            with safe_open(path, "np") as file:
                names = json.loads((file.metadata() or {}).get("rows", "[]"))
                return {name: file.get_tensor(name) for name in file.keys()}, names  # noqa: SIM118
        except (SafetensorError, OSError, ValueError) as error:
            warnings.warn(f"The cached {path} is damaged ({error}); it is made anew.", stacklevel=2)
            return None

    def write(self, path: Path, arrays: Arrays, rows: Sequence[str] = ()) -> None:
        try:
            with replacing(path) as temporary:
                contiguous = {name: np.asarray(array, order="C") for name, array in arrays.items()}
                save_file(contiguous, temporary, {"rows": json.dumps(list(rows))})
        except OSError as error:
            warnings.warn(f"{path} cannot be written ({error}): it is made anew next time.", stacklevel=2)


class Table:
    """One protocol's results for grasps of one object, a row each, by the grasps' keys."""

    def __init__(self, cache: Cache, kind: str, key: Sequence[str | bytes | np.ndarray]):
        self._cache, self._path = cache, cache.path(kind, key)
        arrays, names = cache.read(self._path) or ({}, [])
        self._rows = {name: {k: array[i] for k, array in arrays.items()} for i, name in enumerate(names)}
        self._changed = False

    def __contains__(self, name: str) -> bool:
        return name in self._rows

    def add(self, names: Sequence[str], arrays: Arrays) -> None:
        """Rows of these names; arrays have one entry for each."""
        for i, name in enumerate(names):
            self._rows[name] = {k: array[i] for k, array in arrays.items()}
        self._changed = True

    def rows(self, names: Sequence[str]) -> Arrays:
        """The named rows, in that order."""
        return {k: np.stack([self._rows[name][k] for name in names]) for k in self._rows[names[0]]}

    def save(self) -> None:
        """Write what was added."""
        if self._changed:
            self._cache.write(self._path, self.rows(list(self._rows)), list(self._rows))
            self._changed = False


def _framed(part: str | bytes | np.ndarray) -> str:
    """A part of a key so that no two lists of parts run together to the same."""
    return sha256(part)
