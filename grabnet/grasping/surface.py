"""An object as the optimiser meets it."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from grabnet.geometry.atlas import SDFAtlas


class Surface(Protocol):
    """Signed distances (B, N), metres, and unit normals (B, N, 3) of points (B, N, 3) in the object's frame."""

    def __call__(self, points: Tensor) -> tuple[Tensor, Tensor]: ...


class AtlasSurface:
    """The surface of one object of an atlas, in the object's frame."""

    def __init__(self, atlas: SDFAtlas, index: int = 0):
        self.atlas, self.index = atlas, index

    def __call__(self, points: Tensor) -> tuple[Tensor, Tensor]:
        objects = torch.full((len(points),), self.index, dtype=torch.int64, device=points.device)
        return self.atlas.with_gradient(points, objects)
