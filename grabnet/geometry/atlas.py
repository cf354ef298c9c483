"""Signed distance of many objects by table lookup: the step that makes training on the fly possible (design 3).

Each object has two lattices of cubic voxels in boxes: a fine one close around it, where hands touch, and a coarse one
wide enough for a BPS ball around the object in any rotation. All lattices of an atlas lie in one flat buffer.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from grabnet.geometry.sdf_grid import SDFGrid


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
        spacing = torch.tensor([level.spacing for level in levels])

        def buffer(name: str, value: Tensor) -> None:
            self.register_buffer(name, value, persistent=False)

        buffer("values", torch.cat([level.values.flatten() for level in levels]))
        buffer("spacing", spacing)
        buffer("offset", dims.prod(1).cumsum(0) - dims.prod(1))
        buffer("x_row", dims[:, 1] * dims[:, 2])  # entries of `values` from one x to the next
        buffer("y_row", dims[:, 2].contiguous())
        # Axes first: each is looked up by itself.
        origin = torch.tensor([level.origin for level in levels])
        buffer("origin", origin.mT.contiguous())
        buffer("last", (dims - 1).mT.contiguous())
        buffer("fine_box", torch.stack([origin, origin + spacing[:, None] * (dims - 1)], 1)[::2].contiguous())

    def __len__(self) -> int:
        return len(self.fine_box)

    def forward(self, points: Tensor, objects: Tensor) -> Tensor:
        """Signed distances (B, N) in metres, negative inside, of points (B, N, 3) in the frames of objects (B,)."""
        if torch.is_grad_enabled() and points.requires_grad:
            return self.with_gradient(points, objects)[0]
        return self._lookup(points, objects, gradient=False)[0].to(points.dtype)

    def with_gradient(self, points: Tensor, objects: Tensor) -> tuple[Tensor, Tensor]:
        """Signed distances (B, N) and their gradient (B, N, 3): near the surface its unit normal, pointing outward.

        The distances are differentiable in the points; the gradient is a constant to autograd.
        """
        return _Distance.apply(points, objects, self)

    def _lookup(self, points: Tensor, objects: Tensor, gradient: bool) -> tuple[Tensor, Tensor | None]:
        p = points.detach().float()
        low, high = self.fine_box[objects].unsqueeze(2).unbind(1)
        level = 2 * objects.unsqueeze(1) + ((p < low) | (p > high)).any(-1)
        spacing, x_row, y_row = self.spacing[level], self.x_row[level], self.y_row[level]

        base, fractions, excess = self.offset[level], [], []
        for axis, row in enumerate((x_row, y_row, 1)):
            u = (p[..., axis] - self.origin[axis, level]) / spacing
            last = self.last[axis, level]
            inside = torch.minimum(u.clamp_min(0), last)
            # Clamped again as integers: a NaN must read within the buffer, to come out as NaN.
            cell = torch.minimum(inside.long().clamp_min(0), last - 1)
            base = base + cell * row
            fractions.append(inside - cell)
            excess.append(u - inside)
        beyond = (excess[0] != 0) | (excess[1] != 0) | (excess[2] != 0)
        far = bool(beyond.any())
        value, slope = self._trilinear(base, x_row, y_row, fractions, gradient or far)
        if slope is not None:
            slope = torch.stack(slope, -1) / spacing.unsqueeze(-1)
        if far:
            # From where the point leaves the box the surface lies `value` back along the slope.
            leap = (torch.stack(excess, -1) * spacing.unsqueeze(-1))[beyond]
            leap = leap + value[beyond].unsqueeze(-1) * nn.functional.normalize(slope[beyond], dim=-1)
            value[beyond] = leap.norm(dim=-1)
            slope[beyond] = nn.functional.normalize(leap, dim=-1)
        return value, slope

    def _trilinear(
        self, base: Tensor, x_row: Tensor, y_row: Tensor, fractions: list[Tensor], gradient: bool
    ) -> tuple[Tensor, list[Tensor] | None]:
        """Value at a fraction of the cell whose lowest corner is `values[base]`, and its slopes per cell."""
        fx, fy, fz = fractions

        def along_z(corner: Tensor) -> tuple[Tensor, Tensor]:
            low, high = self.values[corner].float(), self.values[corner + 1].float()
            return torch.lerp(low, high, fz), high - low

        v00, z00 = along_z(base)
        v01, z01 = along_z(base + y_row)
        v10, z10 = along_z(base + x_row)
        v11, z11 = along_z(base + x_row + y_row)
        v0, v1 = torch.lerp(v00, v01, fy), torch.lerp(v10, v11, fy)
        value = torch.lerp(v0, v1, fx)
        if not gradient:
            return value, None
        dz = torch.lerp(torch.lerp(z00, z01, fy), torch.lerp(z10, z11, fy), fx)
        return value, [v1 - v0, torch.lerp(v01 - v00, v11 - v10, fx), dz]


class _Distance(torch.autograd.Function):
    """The lookup finds distance and gradient together, so backward is one product."""

    @staticmethod
    def forward(ctx, points: Tensor, objects: Tensor, atlas: SDFAtlas) -> tuple[Tensor, Tensor]:
        distance, gradient = atlas._lookup(points, objects, gradient=True)
        ctx.save_for_backward(gradient)
        ctx.mark_non_differentiable(gradient)
        return distance.to(points.dtype), gradient.to(points.dtype)

    @staticmethod
    def backward(ctx, d_distance: Tensor, _) -> tuple[Tensor, None, None]:
        (gradient,) = ctx.saved_tensors
        return (d_distance.unsqueeze(-1) * gradient).to(d_distance.dtype), None, None
