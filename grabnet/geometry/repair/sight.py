"""What faces see before and behind them: rays that leave a mesh, and the surfaces that they cross on the way."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
import warp as wp

from grabnet.geometry.kernels import crossings as kernels
from grabnet.geometry.kernels.launch import launch

_RAYS = 16  # to each side
_OFF = 1e-5  # of the mesh's size: where they start, off the face


class Sight(NamedTuple):
    """Shares (F, 2) of the rays before and behind each face: that cross nothing, and an odd number of faces."""

    free: np.ndarray
    odd: np.ndarray


def sight(vertices: np.ndarray, faces: np.ndarray, chosen: np.ndarray, normals: np.ndarray) -> Sight:
    """From the middles of chosen faces, into the half spaces before and behind them.

    Args:
        vertices: (V, 3).
        faces: (F, 3).
        chosen: (C,) numbers of faces.
        normals: (C, 3) of length 1, of these.
    """
    corners = np.asarray(vertices, np.float64)
    middle = (corners.max(0) + corners.min(0)) / 2
    corners = (corners - middle) / np.ptp(corners, axis=0).max()
    mesh = wp.Mesh(
        wp.array(corners.astype(np.float32), dtype=wp.vec3, device="cpu"),
        wp.array(faces.astype(np.int32).ravel(), dtype=wp.int32, device="cpu"),
    )
    directions = np.random.default_rng(0).standard_normal((_RAYS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sides = np.stack([normals, -normals], 1)  # (C, 2, 3)
    ahead = np.where(np.einsum("csi,ri->csr", sides, directions) < 0, -1, 1)[..., None] * directions
    origins = corners[faces[chosen]].mean(1)[:, None] + _OFF * sides
    shape = ahead.shape
    points, ways = (
        torch.from_numpy(np.broadcast_to(x, shape).reshape(-1, 3).astype(np.float32))
        for x in (origins[:, :, None], ahead)
    )
    count = torch.zeros(len(points), dtype=torch.int32)
    launch(kernels.crossings, [points, ways, count], [mesh.id])
    crossed = count.numpy().reshape(shape[:3])
    return Sight((crossed == 0).mean(2), (crossed % 2).mean(2))
