"""The first half of reading pickles that others made: a machine that runs their instructions and nothing else.

A pickle is a program: the usual reader imports and calls whatever it names. Here it can only fill builtin containers
and inert stand-ins, which remember what they were given and do nothing. How much work it can make is bounded: a tuple
or frozenset is no deeper and, as a key, has no more parts than data need, since Python hashes each part, and compares
those of equal hash, as often as it is named; and calls take no more than the pickle's length explains.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from typing import IO, Any

from grabnet.io.npy import plain_dtype

# Tuples and frozensets within others, and parts of one that is a key or in a set; beyond 100,000, Python itself breaks.
MAX_DEPTH = 100
_MAX_KEY = 100


class RefusedError(Exception):
    """Names the class or function that a pickle asked for in vain."""


class _Sealed(type):
    """Makes classes that a pickle cannot change: its BUILD instruction sets attributes of anything it has."""

    def __setattr__(cls, name: str, value: Any) -> None:
        raise pickle.UnpicklingError(f"it changes {cls.__name__}")


class Inert(metaclass=_Sealed):
    """What a pickle said of an object: the arguments it was made with and the state it was given."""

    __slots__ = ("args", "state")

    def __new__(cls, *args: Any) -> Inert:
        made = object.__new__(cls)
        made.args, made.state = args, None
        return made

    def __setstate__(self, state: Any) -> None:
        self.state = state


class Array(Inert):
    """`numpy.ndarray`, and `_reconstruct`, which makes one."""


class FlatArray(Inert):
    """`_frombuffer(buffer, dtype, shape, order)`: how protocol 5 makes an array."""


class Dtype(Inert):
    """`numpy.dtype(code, align, copy)`, of plain values or objects; its state says the byte order."""

    def __new__(cls, code: str, *others: Any) -> Inert:
        try:
            plain_dtype(code)
        except (TypeError, ValueError):
            raise RefusedError(f"numpy array of type {str(code)[:40]}") from None
        return Inert.__new__(cls, code, *others)


class Scalar(Inert):
    """`scalar(dtype, bytes)`."""


class Ch(Inert):
    """`chumpy.ch.Ch`: the array in `x`."""


class Select(Inert):
    """`chumpy.reordering.Select`: elements `idxs` of `a`, in `preferred_shape`."""


class Reshape(Inert):
    """`chumpy.reordering.Reshape`: `a` in `newshape`."""


class Columns(Inert):
    """`scipy.sparse.csc_matrix`: `data` and `indices` of each column, which begin at `indptr`."""


class Rows(Inert):
    """`scipy.sparse.csr_matrix`: likewise by rows."""


class _Reconstructed(Inert):
    """`copyreg._reconstructor(class, object, None)`: how protocols 0 and 1 make an object."""

    def __new__(cls, made: Any, base: Any, state: Any) -> Inert:
        if not isinstance(made, _Sealed) or base is not _Object:
            raise RefusedError("object of an unknown kind")
        return made()


class _Object(Inert):
    """`object`, as the base in a `_reconstructor` call."""


class _Encoded(Inert):
    """`_codecs.encode(text, "latin1")`: how Python 3 writes bytes for Python 2."""

    def __new__(cls, text: str, encoding: str) -> bytes:
        if encoding not in ("latin1", "latin-1"):
            raise RefusedError(f"text in {encoding}")
        return text.encode("latin1")


class _NoBytes(Inert):
    """`bytes()`: how Python 3 writes empty bytes for Python 2."""

    def __new__(cls) -> bytes:
        return b""


class _Counted:
    """What can be a key and hold others: knows how deep it is and of how many parts, each as often as it is named."""

    def __init__(self, items: Any = ()):
        nested = [item for item in self if isinstance(item, _Counted)]
        self.depth = 1 + max((item.depth for item in nested), default=0)
        self.parts = min(len(self) + sum(item.parts for item in nested), _MAX_KEY + 1)
        if self.depth > MAX_DEPTH:
            raise pickle.UnpicklingError(f"tuples or sets nested more than {MAX_DEPTH} deep")

    def __hash__(self) -> int:
        if self.parts > _MAX_KEY:
            raise pickle.UnpicklingError(f"a key of more than {_MAX_KEY} parts")
        return super().__hash__()

    def __setstate__(self, state: Any) -> None:
        raise pickle.UnpicklingError("it changes a tuple or set")  # and what it knows of itself


class _Tuple(_Counted, tuple):
    """A tuple that a pickle makes."""


class _FrozenSet(_Counted, frozenset):
    """A frozenset that a pickle makes."""


STANDS_FOR: dict[tuple[str, str], Callable[..., Any]] = {
    ("numpy", "ndarray"): Array,
    ("numpy", "dtype"): Dtype,
    ("_codecs", "encode"): _Encoded,
    ("chumpy.ch", "Ch"): Ch,
    ("chumpy.reordering", "Select"): Select,
    ("chumpy.reordering", "Reshape"): Reshape,
}
for _module in ("numpy.core", "numpy._core"):
    STANDS_FOR[f"{_module}.multiarray", "_reconstruct"] = Array
    STANDS_FOR[f"{_module}.multiarray", "scalar"] = Scalar
    STANDS_FOR[f"{_module}.numeric", "_frombuffer"] = FlatArray
for _module in ("scipy.sparse.csc", "scipy.sparse._csc"):
    STANDS_FOR[_module, "csc_matrix"] = Columns
for _module in ("scipy.sparse.csr", "scipy.sparse._csr"):
    STANDS_FOR[_module, "csr_matrix"] = Rows
for _module in ("copyreg", "copy_reg"):
    STANDS_FOR[_module, "_reconstructor"] = _Reconstructed
for _module in ("builtins", "__builtin__"):
    STANDS_FOR[_module, "object"] = _Object
    STANDS_FOR[_module, "bytes"] = _NoBytes
    STANDS_FOR[_module, "set"] = set
    STANDS_FOR[_module, "frozenset"] = _FrozenSet


class Reader(pickle._Unpickler):
    """Python's own reader as Python's library has it in Python, whose instructions can be replaced.

    Args:
        stream: of the pickle, read to its end and no further.
        size: bytes that it has at most.
        stands_for: what stands for each class or function, by module and name.
    """

    dispatch = pickle._Unpickler.dispatch.copy()

    def __init__(self, stream: IO[bytes], size: int, stands_for: Mapping[tuple[str, str], Any]):
        super().__init__(stream, encoding="latin1")
        self._stands_for = stands_for
        self._work = 4 * size + 1_000_000

    def find_class(self, module: str, name: str) -> Any:
        try:
            return self._stands_for[module, name]
        except KeyError:
            raise RefusedError(f"{module}.{name}") from None

    def get_extension(self, code: int) -> None:
        raise RefusedError(f"class of number {code}")

    def persistent_load(self, pid: Any) -> Any:
        raise RefusedError("reference to something outside the file")

    def load_tuple(self) -> None:
        items = self.pop_mark()
        self.append(_Tuple(items))

    dispatch[pickle.TUPLE[0]] = load_tuple

    def load_tuple_of(self, n: int) -> None:
        self.stack[-n:] = [_Tuple(self.stack[-n:])]

    dispatch[pickle.EMPTY_TUPLE[0]] = lambda self: self.append(_Tuple(()))
    dispatch[pickle.TUPLE1[0]] = lambda self: self.load_tuple_of(1)
    dispatch[pickle.TUPLE2[0]] = lambda self: self.load_tuple_of(2)
    dispatch[pickle.TUPLE3[0]] = lambda self: self.load_tuple_of(3)

    def load_frozenset(self) -> None:
        items = self.pop_mark()
        self.append(_FrozenSet(items))

    dispatch[pickle.FROZENSET[0]] = load_frozenset

    def load_reduce(self) -> None:
        self._work -= sum(len(argument) for argument in self.stack[-1] if hasattr(argument, "__len__"))
        if self._work < 0:
            raise pickle.UnpicklingError("calls with more data than it has")
        super().load_reduce()

    dispatch[pickle.REDUCE[0]] = load_reduce

    def load_bytearray8(self) -> None:
        """Without taking the memory first that the pickle says it needs."""
        self.append(bytearray(self.read(int.from_bytes(self.read(8), "little"))))

    dispatch[pickle.BYTEARRAY8[0]] = load_bytearray8
