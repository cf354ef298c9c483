"""Signed distance of many objects by table lookup: the step that makes training on the fly possible (ref. 14).

Each object has two lattices of cubic voxels in boxes: a fine one close around it, where hands touch, and a coarse one
wide enough for a BPS ball around the object in any rotation. All lattices of an atlas lie in one flat buffer.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import warp as wp
from torch import Tensor, nn

from grabnet.geometry.kernels import lookup as kernels
from grabnet.geometry.kernels.launch import launch
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
        origin = torch.tensor([level.origin for level in levels])
        spacing = torch.tensor([level.spacing for level in levels])

        def buffer(name: str, value: Tensor) -> None:
            self.register_buffer(name, value.contiguous(), persistent=False)

        buffer("values", torch.cat([level.values.flatten() for level in levels]))
        buffer("origin", origin)
        buffer("spacing", spacing)
        buffer("dims", dims.int())
        buffer("offset", (dims.prod(1).cumsum(0) - dims.prod(1)).int())
        buffer("fine_box", torch.stack([origin, origin + spacing.unsqueeze(1) * (dims - 1)], 1)[::2])
        if len(self.values) >= 2**31:
            raise ValueError(f"{len(grids)} grids hold over 2³¹ nodes: lower fine_nodes or divide the objects")

    def __len__(self) -> int:
        return len(self.fine_box)

    def forward(
        self, points: Tensor, objects: Tensor, rotations: Tensor | None = None, centres: Tensor | None = None
    ) -> Tensor:
        """Signed distances (B, N) in metres, negative inside, of points (B, N, 3) to objects (B,).

        Args:
            rotations, centres: (B, 3, 3) and (B, 3). The points are in a frame at whose origin the object's point
                `centre` lies, and in which it is turned by `rotation`; when omitted, in the object's own frame.
        """
        if torch.is_grad_enabled() and points.requires_grad:
            return self.with_gradient(points, objects, rotations, centres)[0]
        return self._lookup(points, objects, rotations, centres, want_gradient=False)[0]

    def with_gradient(
        self, points: Tensor, objects: Tensor, rotations: Tensor | None = None, centres: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Signed distances (B, N) and their gradient (B, N, 3): near the surface its unit normal, pointing outward.

        The distances are differentiable in the points; the gradient is a constant to autograd. Arguments as above.
        """
        return _Distance.apply(points, objects, rotations, centres, self)

    def basis_distances(self, basis: Tensor, objects: Tensor, rotations: Tensor, centres: Tensor) -> Tensor:
        """Unsigned distances (B, P) of points (P, 3) to objects as in `forward`: what a basis point set needs.

        Read from the coarse lattices alone, in half the time. Measured on the open objects with a ball of 15 cm:
        .09 mm off on average, .84 mm in the worst hundredth, 3.8 mm at most (ref. 14).
        """
        with torch.no_grad():
            distance = basis.new_empty(len(objects), len(basis))
            poses = [rotations.float().contiguous(), centres.float().contiguous(), basis.contiguous()]
            constants = [self._lattices(), objects.int(), *poses, distance]
            launch(kernels.basis_distances, [_by_object(objects)], constants, width=len(basis))
        return distance

    def _lookup(
        self, points: Tensor, objects: Tensor, rotations: Tensor | None, centres: Tensor | None, want_gradient: bool
    ) -> tuple[Tensor, Tensor]:
        if points.dim() != 3 or objects.shape != points.shape[:1]:
            raise ValueError(f"points must be (B, N, 3) and objects (B,), got {points.shape} and {objects.shape}")
        points = points.detach().float().contiguous()
        if rotations is None:
            rotations = torch.eye(3, device=points.device).expand(len(points), 3, 3)
        if centres is None:
            centres = points.new_zeros(len(points), 3)
        distance = points.new_empty(points.shape[:2])
        gradient = torch.empty_like(points) if want_gradient else points  # not written to
        poses = [rotations.float().contiguous(), centres.float().contiguous(), points]
        constants = [self._lattices(), objects.int(), *poses, want_gradient, distance, gradient]
        launch(kernels.signed_distances, [_by_object(objects)], constants, width=points.shape[1])
        return distance, gradient

    def _lattices(self) -> kernels.Lattices:
        lattices = kernels.Lattices()
        for name, variable in kernels.Lattices.vars.items():
            setattr(lattices, name, wp.from_torch(getattr(self, name), dtype=variable.type.dtype))
        return lattices


def _by_object(objects: Tensor) -> Tensor:
    """Order of rows (B,) in which those of one object follow each other: they read the same part of the table."""
    return objects.argsort().int()


class _Distance(torch.autograd.Function):
    """The lookup finds distance and gradient together, so backward is one product."""

    @staticmethod
    def forward(
        ctx, points: Tensor, objects: Tensor, rotations: Tensor | None, centres: Tensor | None, atlas: SDFAtlas
    ) -> tuple[Tensor, Tensor]:
        distance, gradient = atlas._lookup(points, objects, rotations, centres, want_gradient=True)
        ctx.save_for_backward(gradient)
        ctx.mark_non_differentiable(gradient)
        return distance.to(points.dtype), gradient.to(points.dtype)

    @staticmethod
    def backward(ctx, d_distance: Tensor, _) -> tuple[Tensor, None, None, None, None]:
        (gradient,) = ctx.saved_tensors
        return (d_distance.unsqueeze(-1) * gradient).to(d_distance.dtype), None, None, None, None
