"""The typed arrays of a glTF file: its buffers, views of them, and accessors (specification 2.0, section 3.6)."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Callable
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np

from grabnet.geometry.formats.geometry import FormatError
from grabnet.geometry.formats.json_values import extensions_of, item, items, whole

_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC3": 3}
# Values of an accessor, at most: one without data takes none of the file, but memory.
_MOST = 50_000_000
# Extensions that compress views of a buffer.
_COMPRESSED = ("EXT_meshopt_compression", "KHR_meshopt_compression")


class Accessors:
    """Arrays by the number of their accessor.

    Args:
        document: of the file.
        binary: chunk of a .glb file, which its first buffer stands for where it has no URI.
        fetch: bytes of a buffer that lies elsewhere, by its URI.

    Raises:
        FormatError: a buffer that is damaged or shorter than it says.
    """

    def __init__(self, document: dict, binary: bytes | None, fetch: Callable[[str], bytes]):
        self._document = document
        self._buffers: list[bytes | None] = []
        for number, buffer in enumerate(items(document, "buffers")):
            if not isinstance(buffer, dict):
                raise FormatError(f"buffer {number} is damaged: export it again")
            uri = buffer.get("uri")
            if uri is None:
                data = binary if number == 0 else None
            elif not isinstance(uri, str):
                raise FormatError(f"buffer {number} has a URI that is no text: export it again")
            else:
                data = _embedded(uri, number) if uri[:5].lower() == "data:" else fetch(uri)
            if data is not None and len(data) < whole(buffer.get("byteLength"), f"the length of buffer {number}"):
                raise FormatError(f"buffer {number} ends before its {buffer['byteLength']} bytes: export it again")
            self._buffers.append(data)

    def is_stored(self, number: Any) -> bool:
        """Whether an accessor has data of its own."""
        accessor = item(self._document, "accessors", number)
        return "bufferView" in accessor or "sparse" in accessor

    def values(self, number: Any, kind: str) -> np.ndarray:
        """(N, width) float64 values of an accessor of a kind, SCALAR or VEC3; whole numbers are exact.

        Raises:
            FormatError: of another kind, damaged, ended early or compressed.
        """
        accessor = item(self._document, "accessors", number)
        where = f"accessor {number}"
        if accessor.get("type") != kind:
            raise FormatError(f"{where} is of type {accessor.get('type')!s:.10} where {kind} is due: export it again")
        count, width = whole(accessor.get("count"), f"the count of {where}"), _WIDTHS[kind]
        if count * width > _MOST:
            raise FormatError(f"{where} has {count:,} values, more than are read: simplify the mesh")
        dtype = _dtype(accessor, where)
        if "bufferView" in accessor:
            stored = self._view(accessor["bufferView"], accessor, dtype, count, width, where)
        else:
            stored = np.zeros((count, width), dtype)
        if "sparse" in accessor:
            stored = self._replaced(stored, accessor["sparse"], dtype, where)
        values = stored.astype(np.float64)
        if accessor.get("normalized") and dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(dtype).max, -1)
        return values

    def _replaced(self, stored: np.ndarray, sparse: Any, dtype: np.dtype, where: str) -> np.ndarray:
        """Values of which some are stored by their number."""
        parts = [sparse.get(name) if isinstance(sparse, dict) else None for name in ("indices", "values")]
        if not all(isinstance(part, dict) for part in parts):
            raise FormatError(f"{where} has sparse values that are damaged: export it again")
        count = whole(sparse.get("count"), f"the count of sparse values of {where}")
        at, new = parts
        rows = self._view(at.get("bufferView"), at, _dtype(at, where), count, 1, where)[:, 0].astype(np.int64)
        if count and not (rows.min() >= 0 and rows.max() < len(stored)):
            raise FormatError(f"{where} has sparse values beyond its {len(stored)}: export it again")
        stored = stored.copy()
        stored[rows] = self._view(new.get("bufferView"), new, dtype, count, stored.shape[1], where)
        return stored

    def _view(self, number: Any, start: dict, dtype: np.dtype, count: int, width: int, where: str) -> np.ndarray:
        """(count, width) values in a view of a buffer, from the byteOffset of `start` on."""
        view = item(self._document, "bufferViews", number)
        buffer_number = whole(view.get("buffer"), f"the buffer of view {number}")
        data = self._buffers[buffer_number] if buffer_number < len(self._buffers) else None
        if data is None:
            extensions = extensions_of(view, f"view {number}")
            if used := [name for name in _COMPRESSED if name in extensions]:
                raise FormatError(f"{where} is compressed with {used[0]}, which is not read: export it without")
            raise FormatError(f"{where} refers to buffer {buffer_number}, which has no data: export it again")
        offset = whole(view.get("byteOffset", 0), f"the offset of view {number}")
        length = whole(view.get("byteLength"), f"the length of view {number}")
        at = whole(start.get("byteOffset", 0), f"the offset of {where}")
        size = width * dtype.itemsize
        stride = whole(view.get("byteStride", 0), f"the stride of view {number}") or size
        end = at + (count - 1) * stride + size
        if count and (end > length or offset + end > len(data) or stride < size):
            raise FormatError(f"{where} reaches beyond its data: export it again")
        if not count:
            return np.zeros((0, width), dtype)
        block = np.frombuffer(data, np.uint8, end - at, offset + at)
        rows = np.lib.stride_tricks.as_strided(block, (count, size), (stride, 1), writeable=False)
        return np.ascontiguousarray(rows).view(dtype).reshape(count, width)


def _dtype(accessor: dict, where: str) -> np.dtype:
    kind = accessor.get("componentType")
    if not isinstance(kind, int) or kind not in _KINDS:
        raise FormatError(f"{where} has values of the unknown kind {kind!s:.10}: export it again")
    return np.dtype(_KINDS[kind])


def _embedded(uri: str, number: int) -> bytes:
    """Bytes of a data URI."""
    head, comma, body = uri.partition(",")
    data = unquote_to_bytes(body)
    if not comma:
        raise FormatError(f"buffer {number} has a damaged data URI: export it again")
    if not head.lower().endswith(";base64"):
        return data
    try:
        return base64.b64decode(data, validate=True)
    except binascii.Error:
        raise FormatError(f"buffer {number} has damaged base64: export it again") from None
