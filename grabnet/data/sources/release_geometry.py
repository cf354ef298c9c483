"""Vertices and BPS that the published GrabNet data stores beside its parameters (ref. 2), in each of its layouts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor

from grabnet.data.sources.release_names import FrameName
from grabnet.errors import UserError
from grabnet.io.npz import npz_names, npz_rows, read_npz

# Frames held at a time, of 60 kB each.
_BLOCK = 64
# Bytes that one frame's file may unpack to, ten times those of a whole one.
_MAX_FRAME_BYTES = 1 << 20
_REMEDY = "unpack the download again, or set data.source.check=0 to go by the parameters alone"

Shapes = Mapping[str, tuple[int, ...]]


class Block(NamedTuple):
    """What is stored of some frames.

    rows: (n,) int64 rows of the split. arrays: (n, …) float32 by name, metres.
    """

    rows: Tensor
    arrays: dict[str, Tensor]


class StoredGeometry(ABC):
    """What a split stores of its frames besides parameters.

    Attributes:
        layout: how it lies on disk, in words.
        shapes: shape of a frame's row in each array that is there.
    """

    layout: ClassVar[str]
    shapes: Shapes

    @abstractmethod
    def blocks(self, rows: Tensor, names: Sequence[str]) -> Iterator[Block]:
        """Frames `rows` (n,), ascending, of the arrays `names`, some at a time.

        Raises:
            UserError: a file or array that is missing, damaged or misshapen.
        """

    @abstractmethod
    def place(self, row: int) -> str:
        """Where a frame is stored, for messages."""


class FrameFiles(StoredGeometry):
    """One file for each frame.

    Args:
        folder: of the split.
        names: of its frames.
        shapes: of the arrays to look for.
    """

    layout = "parameters in one file, vertices and BPS in a file for each frame"

    def __init__(self, folder: Path, names: Sequence[FrameName], shapes: Shapes):
        self.folder, self.names, self._sought = folder, names, shapes

    @cached_property
    def shapes(self) -> Shapes:
        there = self._arrays(0)
        if found := {name: shape for name, shape in self._sought.items() if name in there}:
            return found
        raise UserError(f"{self.place(0)} holds none of {', '.join(self._sought)}: {_REMEDY}.")

    def blocks(self, rows: Tensor, names: Sequence[str]) -> Iterator[Block]:
        parts = rows.split(_BLOCK)

        def read(row: Tensor) -> list[np.ndarray]:
            arrays = self._arrays(int(row))
            return [fitted(arrays.get(name), (), self.shapes[name], self.place(int(row)), name) for name in names]

        with ThreadPoolExecutor() as pool:
            ahead = pool.map(read, parts[0])
            for part, following in zip(parts, [*parts[1:], ()], strict=True):
                frames, ahead = list(ahead), pool.map(read, following)  # read while this block is compared
                columns = (np.stack([frame[k] for frame in frames]) for k in range(len(names)))
                yield Block(part, {name: torch.as_tensor(c) for name, c in zip(names, columns, strict=True)})

    def place(self, row: int) -> str:
        return str(self.folder.joinpath("data", *self.names[row]))

    def _arrays(self, row: int) -> dict[str, np.ndarray]:
        path = Path(self.place(row))
        if not path.is_file():
            raise UserError(f"{path} is missing, though {self.folder / 'frame_names.npz'} names it: {_REMEDY}.")
        return read_npz(path, _MAX_FRAME_BYTES)


class OneFile(StoredGeometry):
    """Everything of a split in one file.

    Args:
        path: `grabnet_<split>.npz`.
        shapes: of the arrays to look for.
    """

    layout = "everything in one file"

    def __init__(self, path: Path, shapes: Shapes):
        self.path = path
        there = npz_names(path)
        self.shapes = {name: shape for name, shape in shapes.items() if name in there}

    def blocks(self, rows: Tensor, names: Sequence[str]) -> Iterator[Block]:
        streams = [npz_rows(self.path, name, _BLOCK) for name in names]
        for start in range(0, int(rows[-1]) + 1, _BLOCK):
            chunks = {name: next(stream, ()) for name, stream in zip(names, streams, strict=True)}
            among = rows[(rows >= start) & (rows < start + _BLOCK)]
            if not len(among):
                continue
            at = (among - start).numpy()
            for name, chunk in chunks.items():
                if len(chunk) <= at[-1]:
                    raise UserError(f"{self.path}: {name} has no row {among[-1]}: download it again.")
                chunks[name] = fitted(chunk[at], (len(at),), self.shapes[name], str(self.path), name)
            yield Block(among, {name: torch.as_tensor(values) for name, values in chunks.items()})

    def place(self, row: int) -> str:
        return f"{self.path} (row {row})"


class ParametersOnly(StoredGeometry):
    """Nothing but parameters."""

    layout = "parameters only"

    def __init__(self, path: Path):
        self.path = path
        self.shapes = {}

    def blocks(self, rows: Tensor, names: Sequence[str]) -> Iterator[Block]:
        yield from (Block(part, {}) for part in rows.split(_BLOCK))

    def place(self, row: int) -> str:
        return f"{self.path} (row {row})"


def stored_geometry(path: Path, names: Sequence[FrameName], shapes: Shapes) -> StoredGeometry:
    """What there is of a split besides parameters.

    Args:
        path: of its parameters, `grabnet_<split>.npz`.
        names: of its frames.
        shapes: of a frame's row in each array to look for.
    """
    one_file = OneFile(path, shapes)
    if one_file.shapes:
        return one_file
    return FrameFiles(path.parent, names, shapes) if (path.parent / "data").is_dir() else ParametersOnly(path)


def fitted(
    values: np.ndarray | None, lead: tuple[int, ...], shape: tuple[int, ...], place: str, name: str
) -> np.ndarray:
    """Values (*lead, *shape) as float32; they may be stored with a further axis of one, (*lead, 1, *shape).

    Raises:
        UserError: missing, no finite numbers, or of another shape.
    """
    if values is None:
        raise UserError(f"{place} has no array {name}: {_REMEDY}.")
    if values.shape not in ((*lead, *shape), (*lead, 1, *shape)):
        raise UserError(f"{place}: {name} has shape {values.shape}, expected {(*lead, *shape)}: download it again.")
    if values.dtype.kind not in "fiu" or not np.isfinite(values).all():
        raise UserError(f"{place}: {name} holds values that are not finite numbers: download it again.")
    return values.astype(np.float32).reshape(*lead, *shape)
