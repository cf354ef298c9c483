"""Animated glTF of meshes whose vertices move and change colour."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from grabnet.visual.glb_file import ARRAY, INDICES, MATERIAL, Z_UP_TO_Y_UP, GlbFile


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
    file, n = GlbFile(), len(next(iter(parts.values())).vertices)
    faces = {name: file.array(part.faces.astype(np.uint32).reshape(-1, 1), INDICES) for name, part in parts.items()}
    nodes: list[dict[str, Any]] = [{"name": "metres_y_up", "matrix": Z_UP_TO_Y_UP, "children": list(range(1, n + 1))}]
    nodes += [{"name": f"frame_{k}", "scale": [float(k == 0)] * 3, "children": []} for k in range(n)]
    meshes, samplers, channels = [], [], []
    for k in range(n):
        for name, part in parts.items():
            opaque = np.full((part.colours.shape[1], 1), 255, np.uint8)
            attributes = {
                "POSITION": file.array(part.vertices[k].astype(np.float32), ARRAY, bounds=True),
                "COLOR_0": file.array(np.concatenate([part.colours[k], opaque], 1), ARRAY, normalized=True),
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
    return file.packed(
        {
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": nodes,
            "meshes": meshes,
            "materials": [MATERIAL],
            "animations": [{"channels": channels, "samplers": samplers}],
        }
    )
