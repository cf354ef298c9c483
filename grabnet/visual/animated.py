"""Animated glTF of meshes whose vertices move and change colour."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

_ARRAY, _INDICES = 34962, 34963
_KINDS = {np.dtype(np.float32): 5126, np.dtype(np.uint32): 5125, np.dtype(np.uint8): 5121}
_Z_UP_TO_Y_UP = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]  # by column, as glTF has it


class Moving(NamedTuple):
    """A mesh in N frames: vertices (N, V, 3) metres, z up; faces (F, 3); colours (N, V, 3) uint8."""

    vertices: np.ndarray
    faces: np.ndarray
    colours: np.ndarray


def animated_glb(parts: Mapping[str, Moving], rate: float) -> bytes:
    """A .glb file that plays N frames.

    Colours of vertices cannot be animated in glTF 2.0. So each frame has meshes of its own, which share their faces;
    an animation gives those of one frame the scale 1 and all others the scale 0 (specification 2.0, section 3.11).

    Args:
        parts: by name, of equally many frames.
        rate: frames per second.
    """
    file, n = _File(), len(next(iter(parts.values())).vertices)
    faces = {name: file.array(part.faces.astype(np.uint32).reshape(-1, 1), _INDICES) for name, part in parts.items()}
    nodes: list[dict[str, Any]] = [{"name": "metres_y_up", "matrix": _Z_UP_TO_Y_UP, "children": list(range(1, n + 1))}]
    nodes += [{"name": f"frame_{k}", "scale": [float(k == 0)] * 3, "children": []} for k in range(n)]
    meshes, samplers, channels = [], [], []
    for k in range(n):
        for name, part in parts.items():
            opaque = np.full((part.colours.shape[1], 1), 255, np.uint8)
            attributes = {
                "POSITION": file.array(part.vertices[k].astype(np.float32), _ARRAY, bounds=True),
                "COLOR_0": file.array(np.concatenate([part.colours[k], opaque], 1), _ARRAY, normalized=True),
            }
            nodes[k + 1]["children"].append(len(nodes))
            nodes.append({"name": f"{name}_{k}", "mesh": len(meshes)})
            meshes.append({"primitives": [{"attributes": attributes, "indices": faces[name], "material": 0}]})
        # Shown from its own time to the next one's.
        shown = {0.0: float(k == 0), k / rate: 1.0, (k + 1) / rate: float(k == n - 1)}
        times = file.array(np.array(list(shown), np.float32)[:, None], bounds=True)
        scales = file.array(np.repeat(np.array(list(shown.values()), np.float32)[:, None], 3, 1))
        channels.append({"sampler": k, "target": {"node": k + 1, "path": "scale"}})
        samplers.append({"input": times, "output": scales, "interpolation": "STEP"})
    material = {"doubleSided": True, "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.7}}
    return file.packed(
        {
            "asset": {"version": "2.0", "generator": "grabnet"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": nodes,
            "meshes": meshes,
            "materials": [material],
            "animations": [{"channels": channels, "samplers": samplers}],
        }
    )


class _File:
    """The arrays of a .glb file, one after the other."""

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
        arrays = {"accessors": self._accessors, "bufferViews": self._views, "buffers": [{"byteLength": self._length}]}
        text = json.dumps({**scene, **arrays}, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        parts: Sequence[bytes] = [
            struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + self._length),
            struct.pack("<I4s", len(text), b"JSON"),
            text,
            struct.pack("<I4s", self._length, b"BIN\0"),
            *self._blocks,
        ]
        return b"".join(parts)
