"""glTF files put together array by array, where meshes share data or move; `grabnet.visual.scenes` writes others."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

ARRAY, INDICES = 34962, 34963  # what a view of the data is for
MATERIAL = {"doubleSided": True, "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.7}}
Z_UP_TO_Y_UP = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]  # by column, as glTF has it
_KINDS = {np.dtype(np.float32): 5126, np.dtype(np.uint32): 5125, np.dtype(np.uint8): 5121}


class GlbFile:
    """The arrays of a .glb file, one after the other (specification 2.0, section 4.4)."""

    def __init__(self):
        self._blocks: list[bytes] = []
        self._views: list[dict[str, int]] = []
        self._accessors: list[dict[str, Any]] = []
        self._length = 0

    def array(
        self, array: np.ndarray, target: int | None = None, bounds: bool = False, normalized: bool = False
    ) -> int:
        """Number of the accessor to an array (N, width), appended."""
        block = np.ascontiguousarray(array).tobytes()
        view = {"buffer": 0, "byteOffset": self._length, "byteLength": len(block)}
        self._views.append(view if target is None else view | {"target": target})
        accessor: dict[str, Any] = {"bufferView": len(self._views) - 1, "componentType": _KINDS[array.dtype]}
        accessor |= {"count": len(array), "type": ("SCALAR", "", "VEC3", "VEC4")[array.shape[1] - 1]}
        if bounds:
            accessor |= {"min": array.min(0).tolist(), "max": array.max(0).tolist()}
        self._accessors.append(accessor | {"normalized": True} if normalized else accessor)
        self._blocks.append(block + bytes(-len(block) % 4))
        self._length += len(self._blocks[-1])
        return len(self._accessors) - 1

    def packed(self, scene: Mapping[str, Any]) -> bytes:
        """The file of a scene that refers to the arrays."""
        asset = {"asset": {"version": "2.0", "generator": "grabnet"}}
        arrays = {"accessors": self._accessors, "bufferViews": self._views, "buffers": [{"byteLength": self._length}]}
        text = json.dumps({**asset, **scene, **arrays}, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        parts: Sequence[bytes] = [
            struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + self._length),
            struct.pack("<I4s", len(text), b"JSON"),
            text,
            struct.pack("<I4s", self._length, b"BIN\0"),
            *self._blocks,
        ]
        return b"".join(parts)
