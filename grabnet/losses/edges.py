"""The edge loss: how much a mesh is stretched and bent compared with the true one (paper 4)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from grabnet.geometry.kernels import edges as kernels
from grabnet.geometry.kernels.launch import launch


class EdgeL1(nn.Module):
    """Mean |Δ| between a mesh's edge vectors and the true ones, over batch, edges and coordinates.

    One pass over each edge finds the gradient by Δ of a vertex: the signs of Δ along the edges that start there. The
    value is its product with Δ. With torch's indexing either takes ten times as long.

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
        self.register_buffer("vertex", torch.arange(n_vertices, dtype=torch.int32, device=faces.device), False)

    def forward(self, vertices: Tensor, true: Tensor) -> Tensor:
        """Scalar, for vertices and true (B, V, 3); differentiable in the former."""
        return _EdgeL1.apply(vertices - true, self)


class _EdgeL1(torch.autograd.Function):
    @staticmethod
    def forward(ctx, difference: Tensor, edges: EdgeL1) -> Tensor:
        columns = difference.detach().float().permute(1, 2, 0).contiguous()  # the batch last
        signs = torch.zeros_like(columns)
        constants = [edges.neighbours, edges.start, columns]
        launch(kernels.edge_signs, [edges.vertex, signs], constants, width=3 * len(difference))
        count = 3 * len(difference) * edges.n_edges
        ctx.save_for_backward(signs)
        ctx.count = count
        return (torch.dot(columns.flatten(), signs.flatten()) / count).to(difference.dtype)

    @staticmethod
    def backward(ctx, d_loss: Tensor) -> tuple[Tensor, None]:
        (signs,) = ctx.saved_tensors
        return signs.to(d_loss.dtype).permute(2, 0, 1).contiguous() * (d_loss / ctx.count), None
