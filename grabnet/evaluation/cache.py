"""Results kept on disk by content, settings, and a number that code changes raise."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load, save

from grabnet.io.cache import load_or_build, read_cached, write_cached
from grabnet.io.files import sha256
from grabnet.io.tensors import read_facts

# Part of every key: raise it when the same content and settings would give other results.
FORMAT = 5

Arrays = dict[str, np.ndarray]


class Cache:
    """Files of one folder; a damaged or unwritable one costs a warning and time, nothing else.

    Args:
        folder: made when needed.
    """

    def __init__(self, folder: Path):
        self.folder = folder

    def get(self, kind: str, key: Sequence[str | np.ndarray], compute: Callable[[], Arrays]) -> Arrays:
        """Return arrays from `compute`, which is called only where they are not there for this key."""
        return load_or_build(self.path(kind, key), lambda content: _decoded(content)[0], compute, _encoded)

    def get_json(self, kind: str, key: Sequence[str | np.ndarray], compute: Callable[[], Any]) -> Any:
        """Return a value of JSON's types, as `get` does arrays."""

        path = self.path(kind, key).with_suffix(".json")
        return load_or_build(path, json.loads, compute, lambda value: json.dumps(value).encode())

    def path(self, kind: str, key: Sequence[str | np.ndarray]) -> Path:
        """Return the file of a key."""
        # Each part is hashed by itself, so that no two lists of parts run together to the same.
        return self.folder / f"{kind}-{sha256(str(FORMAT), *map(sha256, key))[:32]}.safetensors"


class ResultTable:
    """One protocol's results for grasps of one object, a row each, by the grasps' keys; on disk once saved.

    Arrays may be of numbers or of texts.
    """

    def __init__(self, path: Path):
        self._path = path
        arrays, names = read_cached(path, _decoded) or ({}, [])
        self._rows = {name: {k: array[i] for k, array in arrays.items()} for i, name in enumerate(names)}
        self._changed = False

    def __contains__(self, name: str) -> bool:
        return name in self._rows

    def add(self, names: Sequence[str], arrays: Arrays) -> None:
        """Add rows of these names; arrays have one entry for each."""
        for i, name in enumerate(names):
            self._rows[name] = {k: array[i] for k, array in arrays.items()}
        self._changed = True

    def rows(self, names: Sequence[str]) -> Arrays:
        """Return the named rows, in that order."""
        return {k: np.stack([self._rows[name][k] for name in names]) for k in self._rows[names[0]]}

    def save(self) -> None:
        """Write what was added."""
        if self._changed:
            write_cached(self._path, _encoded(self.rows(list(self._rows)), list(self._rows)))
        self._changed = False


def _decoded(content: bytes) -> tuple[Arrays, list[str]]:
    """Return arrays, and the names of their rows."""
    facts = read_facts(content)
    texts = {name: np.array(values, str) for name, values in json.loads(facts["texts"]).items()}
    # By name: in a file they lie in an order that changes from process to process.
    return dict(sorted((load(content) | texts).items())), json.loads(facts["rows"])


def _encoded(arrays: Arrays, rows: Sequence[str] = ()) -> bytes:
    """Numbers as tensors; texts and the names of rows in the header."""
    texts = {name: array.tolist() for name, array in arrays.items() if array.dtype.kind == "U"}
    numbers = {name: np.asarray(array, order="C") for name, array in arrays.items() if name not in texts}
    return save(numbers, {"rows": json.dumps(list(rows)), "texts": json.dumps(texts)})
