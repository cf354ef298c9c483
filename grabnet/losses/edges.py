"""The edge loss: how much a mesh is stretched and bent compared with the true one (paper 5.1)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from grabnet.geometry.warping import launch
from grabnet.losses import edge_kernels as kernels


class EdgeL1(nn.Module):
    """Mean |Δ| between a mesh's edge vectors and the true ones, over batch, edges and coordinates.

    One pass over each mesh finds value and gradient; with torch's indexing either way takes ten times as long.

    Args:
        faces: (F, 3) int; each of their edges counts once.
        n_vertices: V.
    """

    def __init__(self, faces: Tensor, n_vertices: int):
        super().__init__()
        edges = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        ends = torch.cat([edges, edges.flip(1)]).unique(dim=0)  # either way, by the vertex that they start at
        counts = torch.bincount(ends[:, 0], minlength=n_vertices)
        self.n_edges = len(ends) // 2
        self.register_buffer("neighbours", ends[:, 1].int().contiguous(), False)
        self.register_buffer("start", torch.cat([counts.new_zeros(1), counts.cumsum(0)]).int(), False)

    def forward(self, vertices: Tensor, true: Tensor) -> Tensor:
        """Scalar, for vertices and true (B, V, 3); differentiable in the former."""
        return _EdgeL1.apply(vertices - true, self)


class _EdgeL1(torch.autograd.Function):
    @staticmethod
    def forward(ctx, difference: Tensor, edges: EdgeL1) -> Tensor:
        rows = difference.detach().float().contiguous()
        total, gradient = rows.new_empty(rows.shape[:2]), torch.empty_like(rows)
        launch(kernels.edge_l1, [rows, total, gradient], [edges.start, edges.neighbours], width=rows.shape[1])
        count = 3 * len(rows) * edges.n_edges
        ctx.save_for_backward(gradient)
        ctx.count = count
        return (total.sum() / (2 * count)).to(difference.dtype)  # each edge was met twice

    @staticmethod
    def backward(ctx, d_loss: Tensor) -> tuple[Tensor, None]:
        (gradient,) = ctx.saved_tensors
        return gradient.to(d_loss.dtype) * (d_loss / ctx.count), None
