"""Signed distance of many objects by table lookup: the step that makes training on the fly possible (design 3).

Each object has two lattices of cubic voxels in boxes: a fine one close around it, where hands touch, and a coarse one
wide enough for a BPS ball around the object in any rotation. All lattices of an atlas lie in one flat buffer.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import warp as wp
from torch import Tensor, nn

from grabnet.geometry import lookup_kernels as kernels
from grabnet.geometry.sdf_grid import SDFGrid
from grabnet.geometry.warping import launch, shared


class SDFAtlas(nn.Module):
    """Signed distances to any of several objects, differentiable in the points.

    Within an object's coarse box distances are interpolated trilinearly and the gradient is that of the interpolant;
    beyond it both are those of the surface point nearest to where the point leaves the box.

    Args:
        grids: one per object; `objects` below index this sequence.
    """

    def __init__(self, grids: Sequence[SDFGrid]):
        super().__init__()
        levels = [level for grid in grids for level in grid.levels]  # fine and coarse of object 0, then of 1, …
        dims = torch.tensor([level.values.shape for level in levels])
        origin = torch.tensor([level.origin for level in levels])
        spacing = torch.tensor([level.spacing for level in levels])

        def buffer(name: str, value: Tensor) -> None:
            self.register_buffer(name, value.contiguous(), persistent=False)

        buffer("values", torch.cat([level.values.flatten() for level in levels]))
        buffer("origin", origin)
        buffer("spacing", spacing)
        buffer("dims", dims.int())
        buffer("offset", dims.prod(1).cumsum(0) - dims.prod(1))
        buffer("fine_low", origin[::2])
        buffer("fine_high", (origin + spacing.unsqueeze(1) * (dims - 1))[::2])

    def __len__(self) -> int:
        return len(self.fine_low)

    def forward(self, points: Tensor, objects: Tensor) -> Tensor:
        """Signed distances (B, N) in metres, negative inside, of points (B, N, 3) in the frames of objects (B,)."""
        if torch.is_grad_enabled() and points.requires_grad:
            return self.with_gradient(points, objects)[0]
        return self._lookup(points, objects, want_gradient=False)[0]

    def with_gradient(self, points: Tensor, objects: Tensor) -> tuple[Tensor, Tensor]:
        """Signed distances (B, N) and their gradient (B, N, 3): near the surface its unit normal, pointing outward.

        The distances are differentiable in the points; the gradient is a constant to autograd.
        """
        return _Distance.apply(points, objects, self)

    def _lookup(self, points: Tensor, objects: Tensor, want_gradient: bool) -> tuple[Tensor, Tensor]:
        points, objects = points.detach().float().contiguous(), objects.long().contiguous()
        if points.dim() != 3 or objects.shape != points.shape[:1]:
            raise ValueError(f"points must be (B, N, 3) and objects (B,), got {points.shape} and {objects.shape}")
        distance = points.new_empty(points.shape[:2])
        gradient = torch.empty_like(points) if want_gradient else points
        cells = (
            torch.empty_like(distance, dtype=torch.int32),
            torch.empty_like(distance, dtype=torch.int64),
            torch.empty_like(points),
            torch.empty_like(points),
        )
        levels = self._levels()
        launch(kernels.locate, [points, objects, *cells], [levels], dims=2)
        constants = [shared(self.values), levels, want_gradient]
        launch(kernels.interpolate, [*cells, distance, gradient], constants, dims=2)
        return distance, gradient

    def _levels(self) -> kernels.Levels:
        levels = kernels.Levels()
        for name in ("origin", "fine_low", "fine_high"):
            setattr(levels, name, shared(getattr(self, name), wp.vec3))
        levels.dims = shared(self.dims, wp.vec3i)
        levels.spacing, levels.offset = shared(self.spacing), shared(self.offset)
        return levels


class _Distance(torch.autograd.Function):
    """The lookup finds distance and gradient together, so backward is one product."""

    @staticmethod
    def forward(ctx, points: Tensor, objects: Tensor, atlas: SDFAtlas) -> tuple[Tensor, Tensor]:
        distance, gradient = atlas._lookup(points, objects, want_gradient=True)
        ctx.save_for_backward(gradient)
        ctx.mark_non_differentiable(gradient)
        return distance.to(points.dtype), gradient.to(points.dtype)

    @staticmethod
    def backward(ctx, d_distance: Tensor, _) -> tuple[Tensor, None, None]:
        (gradient,) = ctx.saved_tensors
        return (d_distance.unsqueeze(-1) * gradient).to(d_distance.dtype), None, None
