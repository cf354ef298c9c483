"""Reading pickles that others made, without running anything of what they say.

`grabnet.io.unpickling` runs a pickle's instructions into containers and inert stand-ins. What these mean (numpy
arrays, scalars and dtypes, chumpy arrays, sparse matrices) is worked out here from what they remember, with none of the
pickle's own classes; numpy's reader isn't safe here either, since a pickled dtype may claim that bytes are pointers.
"""

from __future__ import annotations

import io
import math
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from grabnet.errors import UserError
from grabnet.io import unpickling
from grabnet.io.files import existing_file
from grabnet.io.npy import check_size, check_text, plain_dtype
from grabnet.io.unpickling import MAX_DEPTH, STANDS_FOR, Reader, RefusedError

# Bytes that one file may hold or one array take once unpacked; GRAB's largest sequences stay below a tenth of it.
MAX_BYTES = 4 << 30
# Bytes that arrays may take beyond four times those of their file: sparse matrices are stored without zeros.
_MAX_UNFOLDED = 256 << 20
# Parts of a pickle, each counted as often as it is named, and as one more for each 16 characters.
_MAX_PARTS = 10_000_000
_MAX_BITS = 256  # of a whole number; Python does not print any


def read_pickle(path: str | Path) -> Any:
    """The content of a pickle file; see `decode_pickle`."""
    path = existing_file(path, "Pickle", MAX_BYTES)
    return decode_pickle(path.read_bytes(), str(path))


def decode_pickle(data: bytes, name: str) -> Any:
    """Plain values of a pickle: numbers, text, bytes, dict, list, tuple, set and numpy arrays of numbers or text.

    Arrays of objects come back as arrays of decoded objects; chumpy arrays and scipy's sparse matrices as plain dense
    arrays. Text that Python 2 wrote is read as latin-1.

    Args:
        data: the pickle.
        name: of its source, for messages.

    Raises:
        UserError: it names any other class or function, or is damaged, or unfolds to more than is read.
    """
    try:
        return _Decoder(len(data))(Reader(io.BytesIO(data), len(data), STANDS_FOR).load())
    except RefusedError as refused:
        raise UserError(
            f"{name} holds a pickled {refused}, which is not loaded: only plain containers, numpy and chumpy arrays "
            f"and sparse matrices are; save it again without it."
        ) from None
    except Exception as error:  # a damaged pickle can fail in any way
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise UserError(f"{name} is not a readable pickle ({reason}).") from None


class _Decoder:
    """Turns what was read into plain values, each shared part once.

    What is shared is counted as often as it is named, since whoever goes through the values, or prints them, does so.

    Args:
        size: bytes of the pickle.
    """

    def __init__(self, size: int) -> None:
        self._done: dict[int, tuple[Any, int]] = {}  # values, and of how many parts they are
        self._parts = 0
        self._depth = 0
        self._limit = self._room = min(4 * size + _MAX_UNFOLDED, MAX_BYTES)  # bytes that further arrays may take

    def __call__(self, value: Any) -> Any:
        key = id(value)  # every part stays alive as long as the whole does
        if key not in self._done:
            self._done[key] = _UNFINISHED, 0
            self._depth += 1
            if self._depth > MAX_DEPTH:
                raise pickle.UnpicklingError(f"values nested more than {MAX_DEPTH} deep")
            before = self._parts
            result = self._decoded(value)
            self._depth -= 1
            self._done[key] = result, self._parts - before + 1
            self._parts += 1
        else:
            result, parts = self._done[key]
            self._parts += parts
        if result is _UNFINISHED:
            raise pickle.UnpicklingError("it holds itself")
        if self._parts > _MAX_PARTS:
            raise pickle.UnpicklingError(f"it unfolds to more than {_MAX_PARTS:,} parts")
        return result

    def _decoded(self, value: Any) -> Any:
        if isinstance(value, dict):
            return {self(k): self(v) for k, v in value.items()}
        if isinstance(value, list | tuple | set | frozenset):
            kind = next(k for k in (list, tuple, set, frozenset) if isinstance(value, k))
            return kind(self(v) for v in value)
        if isinstance(value, str | bytes | bytearray):
            self._parts += len(value) // 16
            if isinstance(value, str):
                value.encode()  # refuses what is no character
            return value
        if isinstance(value, int) and value.bit_length() > _MAX_BITS:
            raise pickle.UnpicklingError(f"a number of {value.bit_length()} bits")
        if value is None or type(value) in (bool, int, float):
            return value
        decoders: dict[type, Callable[[Any], Any]] = {
            unpickling.Array: self._array,
            unpickling.FlatArray: self._flat_array,
            unpickling.Scalar: lambda v: self._filled(v.args[0], (), v.args[1])[()],
            unpickling.Dtype: self._dtype,
            unpickling.Ch: lambda v: self._number_array(v.state["x"]),
            unpickling.Select: self._select,
            unpickling.Reshape: lambda v: self._reshaped(self._number_array(v.state["a"]), v.state["newshape"]),
            unpickling.Columns: lambda v: self._dense(v, by_column=True),
            unpickling.Rows: lambda v: self._dense(v, by_column=False),
        }
        if type(value) not in decoders:
            raise RefusedError(f"{getattr(value, '__name__', type(value).__name__).lstrip('_')} by itself")
        return decoders[type(value)](value)

    def _array(self, value: unpickling.Array) -> np.ndarray:
        _, shape, dtype, fortran, content = value.state
        return self._filled(dtype, shape, content, "F" if fortran else "C")

    def _flat_array(self, value: unpickling.FlatArray) -> np.ndarray:
        content, dtype, shape, order = value.args
        return self._filled(dtype, shape, content, order)

    def _dtype(self, value: unpickling.Dtype) -> np.dtype:
        order = value.state[1] if value.state else "="
        return plain_dtype(value.args[0]).newbyteorder({"|": "="}.get(order, order))

    def _filled(self, dtype: Any, shape: Any, content: Any, order: str = "C") -> np.ndarray:
        """An array of our own making."""
        dtype = self(dtype)
        shape = tuple(int(n) for n in shape)
        check_size(shape, dtype, MAX_BYTES)
        self._make_room(len(content) * (8 if dtype.kind == "O" else 1))
        if dtype.kind == "O":
            array = np.empty(len(content), object)
            for i, item in enumerate(content):
                array[i] = self(item)
        else:
            content = content.encode("latin1") if isinstance(content, str) else bytes(content)
            if math.prod(shape) * dtype.itemsize != len(content):
                raise pickle.UnpicklingError(f"{len(content)} bytes for an array of shape {shape}")
            array = np.frombuffer(content, dtype).astype(dtype.newbyteorder("="))
            check_text(array)
        return array.reshape(shape, order=order)

    def _number_array(self, value: Any) -> np.ndarray:
        array = np.asarray(self(value))
        if array.dtype.kind not in "biuf":
            raise pickle.UnpicklingError("an array that holds no numbers")
        return array

    def _select(self, value: unpickling.Select) -> np.ndarray:
        array, index = (self._number_array(value.state[name]) for name in ("a", "idxs"))
        self._make_room(array.nbytes + index.size * array.itemsize)
        chosen = array.ravel()[index]
        shape = value.state.get("preferred_shape")
        return chosen if shape is None else self._reshaped(chosen, shape)

    def _reshaped(self, array: np.ndarray, shape: Any) -> np.ndarray:
        array = array.reshape(self(shape))
        check_size(array.shape, array.dtype, MAX_BYTES)
        return array

    def _dense(self, value: unpickling.Inert, by_column: bool) -> np.ndarray:
        state = value.state
        shape = tuple(int(n) for n in self(state["_shape"] if "_shape" in state else state["shape"]))
        data, minor, start = (self._number_array(state[name]) for name in ("data", "indices", "indptr"))
        if len(shape) != 2 or min(shape) < 0:
            raise pickle.UnpicklingError(f"a sparse matrix of shape {shape}")
        self._make_room(math.prod(shape) * data.itemsize)
        check_size(shape, data.dtype, MAX_BYTES)
        counts = np.diff(start)
        if start[0] != 0 or (counts < 0).any() or len(minor) != start[-1]:
            raise pickle.UnpicklingError("a sparse matrix whose parts don't fit")
        major = np.repeat(np.arange(len(counts)), counts)
        at = (minor, major) if by_column else (major, minor)
        if len(data) and (minor.min() < 0 or any(i.max() >= n for i, n in zip(at, shape, strict=True))):
            raise pickle.UnpicklingError("a sparse matrix with entries outside it")
        dense = np.zeros(shape, data.dtype)
        np.add.at(dense, at, data)
        return dense

    def _make_room(self, size: int) -> None:
        self._room -= size
        if self._room < 0:
            raise pickle.UnpicklingError(f"it unfolds to more than {self._limit:,} bytes")


_UNFINISHED = object()
