"""Reading pickles that others made, without running anything of what they say.

A pickle is a program: the usual reader imports and calls whatever it names. Here it can only fill builtin containers
and inert stand-ins, which remember what they were given and do nothing. What the stand-ins mean (numpy arrays, scalars
and dtypes, chumpy arrays, sparse matrices) is worked out afterwards from what they remember, with none of the pickle's
own classes; numpy's own reader isn't safe here either, since a pickled dtype may claim that bytes are pointers.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from grabnet.errors import UserError
from grabnet.io.files import existing

# Bytes that one file may hold or one array take once unpacked; GRAB's largest sequences stay below a tenth of it.
MAX_BYTES = 4 << 30


def read_pickle(path: str | Path) -> Any:
    """The content of a pickle file; see `decode_pickle`."""
    path = existing(path, "Pickle")
    if path.is_dir() or path.stat().st_size > MAX_BYTES:
        raise UserError(f"{path} is no pickle file of at most {MAX_BYTES >> 30} GiB.")
    return decode_pickle(path.read_bytes(), str(path))


def decode_pickle(data: bytes, name: str) -> Any:
    """Plain values of a pickle: numbers, text, bytes, dict, list, tuple, set and numpy arrays of numbers or text.

    Arrays of objects come back as arrays of decoded objects; chumpy arrays and scipy's sparse matrices as plain dense
    arrays. Text that Python 2 wrote is read as latin-1.

    Args:
        data: the pickle.
        name: of its source, for messages.

    Raises:
        UserError: it names any other class or function, or is damaged, or unfolds to more than `MAX_BYTES`.
    """
    try:
        _check_memo(data)
        return _Decoder()(_Reader(io.BytesIO(data), encoding="latin1").load())
    except _RefusedError as refused:
        raise UserError(
            f"{name} holds a pickled {refused}, which is not loaded: only plain containers, numpy and chumpy arrays "
            f"and sparse matrices are; save it again without it."
        ) from None
    except Exception as error:  # a damaged pickle can fail in any way
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise UserError(f"{name} is not a readable pickle ({reason}).") from None


class _RefusedError(Exception):
    """Names the class or function that a pickle asked for in vain."""


def _check_memo(data: bytes) -> None:
    """Refuse memo numbers beyond the pickle's own length: the reader would make a table that long."""
    for opcode, argument, _ in pickletools.genops(data):
        if opcode.name in ("PUT", "BINPUT", "LONG_BINPUT") and argument > len(data):
            raise pickle.UnpicklingError(f"memo number {argument}")


class _Sealed(type):
    """Makes classes that a pickle cannot change: its BUILD instruction sets attributes of anything it has."""

    def __setattr__(cls, name: str, value: Any) -> None:
        raise pickle.UnpicklingError(f"it changes {cls.__name__}")


class _Inert(metaclass=_Sealed):
    """What a pickle said of an object: the arguments it was made with and the state it was given."""

    __slots__ = ("args", "state")

    def __new__(cls, *args: Any) -> _Inert:
        made = object.__new__(cls)
        made.args, made.state = args, None
        return made

    def __setstate__(self, state: Any) -> None:
        self.state = state


class _Array(_Inert):
    """`numpy.ndarray`, and `_reconstruct`, which makes one."""


class _FlatArray(_Inert):
    """`_frombuffer(buffer, dtype, shape, order)`: how protocol 5 makes an array."""


class _Dtype(_Inert):
    """`numpy.dtype(code, align, copy)`; its state says the byte order."""


class _Scalar(_Inert):
    """`scalar(dtype, bytes)`."""


class _Ch(_Inert):
    """`chumpy.ch.Ch`: the array in `x`."""


class _Select(_Inert):
    """`chumpy.reordering.Select`: elements `idxs` of `a`, in `preferred_shape`."""


class _Reshape(_Inert):
    """`chumpy.reordering.Reshape`: `a` in `newshape`."""


class _Columns(_Inert):
    """`scipy.sparse.csc_matrix`: `data` and `indices` of each column, which begin at `indptr`."""


class _Rows(_Inert):
    """`scipy.sparse.csr_matrix`: likewise by rows."""


class _Reconstructed(_Inert):
    """`copyreg._reconstructor(class, object, None)`: how protocols 0 and 1 make an object."""

    def __new__(cls, made: Any, base: Any, state: Any) -> _Inert:
        if not isinstance(made, _Sealed) or base is not _Object:
            raise _RefusedError("object of an unknown kind")
        return made()


class _Object(_Inert):
    """`object`, as the base in a `_reconstructor` call."""


class _Encoded(_Inert):
    """`_codecs.encode(text, "latin1")`: how Python 3 writes bytes for Python 2."""

    def __new__(cls, text: str, encoding: str) -> bytes:
        if encoding not in ("latin1", "latin-1"):
            raise _RefusedError(f"text in {encoding}")
        return text.encode("latin1")


class _NoBytes(_Inert):
    """`bytes()`: how Python 3 writes empty bytes for Python 2."""

    def __new__(cls) -> bytes:
        return b""


_STANDS_FOR: dict[tuple[str, str], Callable[..., Any]] = {
    ("numpy", "ndarray"): _Array,
    ("numpy", "dtype"): _Dtype,
    ("_codecs", "encode"): _Encoded,
    ("chumpy.ch", "Ch"): _Ch,
    ("chumpy.reordering", "Select"): _Select,
    ("chumpy.reordering", "Reshape"): _Reshape,
}
for _module in ("numpy.core", "numpy._core"):
    _STANDS_FOR[f"{_module}.multiarray", "_reconstruct"] = _Array
    _STANDS_FOR[f"{_module}.multiarray", "scalar"] = _Scalar
    _STANDS_FOR[f"{_module}.numeric", "_frombuffer"] = _FlatArray
for _module in ("scipy.sparse.csc", "scipy.sparse._csc"):
    _STANDS_FOR[_module, "csc_matrix"] = _Columns
for _module in ("scipy.sparse.csr", "scipy.sparse._csr"):
    _STANDS_FOR[_module, "csr_matrix"] = _Rows
for _module in ("copyreg", "copy_reg"):
    _STANDS_FOR[_module, "_reconstructor"] = _Reconstructed
for _module in ("builtins", "__builtin__"):
    _STANDS_FOR[_module, "object"] = _Object
    _STANDS_FOR[_module, "bytes"] = _NoBytes
    _STANDS_FOR[_module, "set"] = set
    _STANDS_FOR[_module, "frozenset"] = frozenset


class _Reader(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        try:
            return _STANDS_FOR[module, name]
        except KeyError:
            raise _RefusedError(f"{module}.{name}") from None

    def persistent_load(self, pid: Any) -> Any:
        raise _RefusedError("reference to something outside the file")


class _Decoder:
    """Turns what was read into plain values, each shared part once, so that sharing can't multiply."""

    def __init__(self) -> None:
        self.done: dict[int, Any] = {}
        self.bytes = 0  # of all arrays made

    def __call__(self, value: Any) -> Any:
        key = id(value)  # every part stays alive as long as the whole does
        if key not in self.done:
            self.done[key] = _UNFINISHED
            self.done[key] = self._decoded(value)
        if self.done[key] is _UNFINISHED:
            raise pickle.UnpicklingError("it holds itself")
        return self.done[key]

    def _decoded(self, value: Any) -> Any:
        if isinstance(value, dict):
            return {self(k): self(v) for k, v in value.items()}
        if type(value) in (list, tuple, set, frozenset):
            return type(value)(self(v) for v in value)
        if value is None or type(value) in (bool, int, float, str, bytes, bytearray):
            return value
        decoders: dict[type, Callable[[Any], Any]] = {
            _Array: self._array,
            _FlatArray: self._flat_array,
            _Scalar: lambda v: self._filled(v.args[0], (), v.args[1])[()],
            _Dtype: self._dtype,
            _Ch: lambda v: self._number_array(v.state["x"]),
            _Select: self._select,
            _Reshape: lambda v: self._number_array(v.state["a"]).reshape(self(v.state["newshape"])),
            _Columns: lambda v: self._dense(v, by_column=True),
            _Rows: lambda v: self._dense(v, by_column=False),
        }
        if type(value) not in decoders:
            raise _RefusedError(f"{getattr(value, '__name__', type(value).__name__).lstrip('_')} by itself")
        return decoders[type(value)](value)

    def _array(self, value: _Array) -> np.ndarray:
        _, shape, dtype, fortran, content = value.state
        return self._filled(dtype, shape, content, "F" if fortran else "C")

    def _flat_array(self, value: _FlatArray) -> np.ndarray:
        content, dtype, shape, order = value.args
        return self._filled(dtype, shape, content, order)

    def _dtype(self, value: _Dtype) -> np.dtype:
        """Booleans, numbers, text, bytes and objects."""
        code = value.args[0]
        dtype = np.dtype(code if isinstance(code, str) else "V")
        if dtype.kind not in "biufcSUO" or dtype.fields is not None:
            raise _RefusedError(f"numpy array of type {code}")
        order = value.state[1] if value.state else "="
        return dtype.newbyteorder({"|": "="}.get(order, order))

    def _filled(self, dtype: Any, shape: Any, content: Any, order: str = "C") -> np.ndarray:
        """An array of our own making."""
        dtype = self(dtype)
        shape = tuple(int(n) for n in shape)
        size = math.prod(shape)
        self._make_room(len(content) * (8 if dtype.kind == "O" else 1))
        if dtype.kind == "O":
            array = np.empty(len(content), object)
            for i, item in enumerate(content):
                array[i] = self(item)
        else:
            content = content.encode("latin1") if isinstance(content, str) else bytes(content)
            if size * dtype.itemsize != len(content):
                raise pickle.UnpicklingError(f"{len(content)} bytes for an array of shape {shape}")
            array = np.frombuffer(content, dtype).astype(dtype.newbyteorder("="))
        return array.reshape(shape, order=order)

    def _number_array(self, value: Any) -> np.ndarray:
        array = np.asarray(self(value))
        if array.dtype.kind not in "biuf":
            raise pickle.UnpicklingError("an array that holds no numbers")
        return array

    def _select(self, value: _Select) -> np.ndarray:
        chosen = self._number_array(value.state["a"]).ravel()[self._number_array(value.state["idxs"])]
        self._make_room(chosen.nbytes)
        shape = value.state.get("preferred_shape")
        return chosen if shape is None else chosen.reshape(self(shape))

    def _dense(self, value: _Inert, by_column: bool) -> np.ndarray:
        state = value.state
        shape = tuple(int(n) for n in self(state["_shape"] if "_shape" in state else state["shape"]))
        data, minor, start = (self._number_array(state[name]) for name in ("data", "indices", "indptr"))
        if len(shape) != 2 or min(shape) < 0:
            raise pickle.UnpicklingError(f"a sparse matrix of shape {shape}")
        self._make_room(math.prod(shape) * data.itemsize)
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
        self.bytes += size
        if self.bytes > MAX_BYTES:
            raise pickle.UnpicklingError(f"it unfolds to more than {MAX_BYTES >> 30} GiB")


_UNFINISHED = object()
