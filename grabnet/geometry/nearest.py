"""Exact distances to points: to the vertices of a mesh that deforms, such as a posed hand, or to any cloud."""

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor, nn

from grabnet.geometry.kernels import nearest as kernels
from grabnet.geometry.kernels.launch import launch

# Queries that are compared at once.
GROUP = kernels.GROUP
# Points that are compared or left out together.
BLOCK = 32


class NearestVertex(nn.Module):
    """Finds nearest vertices on poses of one mesh.

    Args:
        faces: (F, 3) int, oriented outwards.
        rest: (V, 3) the mesh in any pose: what are neighbours in it is searched together.
    """

    def __init__(self, faces: Tensor, rest: Tensor):
        super().__init__()
        n_vertices = len(rest)
        corners = faces.flatten().argsort(stable=True)
        opposite = torch.stack([faces.roll(-1, 1), faces.roll(-2, 1)], -1).flatten(0, 1)[corners]
        counts = torch.bincount(faces.flatten(), minlength=n_vertices)
        self.register_buffer("opposite", opposite.int().contiguous(), False)
        self.register_buffer("start", torch.cat([counts.new_zeros(1), counts.cumsum(0)]).int(), False)
        self.register_buffer("order", by_neighbourhood(rest, BLOCK).int(), False)

    @torch.no_grad()
    def forward(self, queries: Tensor, vertices: Tensor) -> tuple[Tensor, Tensor]:
        """Find the nearest of vertices (B, V, 3) to each of queries (B, Q, 3); fastest in the order `by_neighbourhood`.

        Returns:
            its index (B, Q) int32, and its distance (B, Q), negative where the query lies behind the surface there:
            against the vertex's normal, the sum of its faces' normals weighted by area.
        """
        queries, vertices = queries.float().contiguous(), vertices.float().contiguous()
        normals, topology = torch.empty_like(vertices), self._topology()
        launch(kernels.vertex_normals, [vertices, normals], [topology], width=vertices.shape[1])
        index, distance = nearest_point(queries, vertices[:, self.order]), torch.empty_like(queries[..., 0])
        items = [vertices, normals, queries, index, distance]
        launch(kernels.signed_distances, items, [topology], width=queries.shape[1])
        return index, distance

    def signed_offset(self, queries: Tensor, vertices: Tensor) -> Tensor:
        """Signed distances (B, Q) as `forward` finds them, in single precision; differentiable in the vertices."""
        return _SignedOffset.apply(vertices, queries, self)

    def _topology(self) -> kernels.Topology:
        topology = kernels.Topology()
        for name, variable in kernels.Topology.vars.items():
            setattr(topology, name, wp.from_torch(getattr(self, name), dtype=variable.type.dtype))
        return topology


class _SignedOffset(torch.autograd.Function):
    """One pass over the queries each way: with torch's indexing both take three times as long."""

    @staticmethod
    def forward(ctx, vertices: Tensor, queries: Tensor, nearest: NearestVertex) -> Tensor:
        index, distance = nearest(queries, vertices)
        ctx.save_for_backward(vertices, queries, index, distance)
        return distance

    @staticmethod
    def backward(ctx, d_distance: Tensor) -> tuple[Tensor, None, None]:
        vertices, queries, index, distance = ctx.saved_tensors
        d_vertices = torch.zeros_like(vertices, dtype=torch.float32, memory_format=torch.contiguous_format)
        placed = [vertices.float().contiguous(), queries.float().contiguous(), index, distance]
        items = [*placed, d_distance.float().contiguous(), d_vertices]
        launch(kernels.distance_gradient, items, [], width=queries.shape[1])
        return d_vertices.to(vertices.dtype), None, None


def by_neighbourhood(points: Tensor, size: int) -> Tensor:
    """Numbers (N,) of points (N, 3) in an order in which each `size` of them, from the first on, lie close together.

    Halves the points across their longest extent until the parts are so small.
    """

    def halved(part: Tensor) -> list[Tensor]:
        if len(part) <= size:
            return [part]
        extent = points[part].amax(0) - points[part].amin(0)
        part = part[points[part, extent.argmax()].argsort(stable=True)]
        half = -(-len(part) // size) // 2 * size
        return halved(part[:half]) + halved(part[half:])

    return torch.cat(halved(torch.arange(len(points), device=points.device)))


@torch.no_grad()
def nearest_point(queries: Tensor, points: Tensor) -> Tensor:
    """Index (B, Q) int32 of the nearest of points (B, N, 3) to each of queries (B, Q, 3); exact.

    Fastest where both are in the order `by_neighbourhood`.
    """
    queries, points = queries.float().contiguous(), points.float()
    filling = points[:, -1:].expand(-1, -points.shape[1] % BLOCK, -1)
    coordinates = torch.cat([points, filling], 1).mT.contiguous()
    low, high = coordinates.unflatten(2, (-1, BLOCK)).aminmax(dim=-1)
    index = torch.empty(queries.shape[:2], dtype=torch.int32, device=queries.device)
    items = [coordinates, torch.cat([low, high], 1), queries, index]
    launch(kernels.nearest_points, items, [], width=queries.shape[1])
    return index.clamp_(max=points.shape[1] - 1)


def nearest_point_distance(queries: Tensor, points: Tensor) -> Tensor:
    """Distance (B, Q) of queries (B, Q, 3) to the nearest of points (B, N, 3); differentiable in both."""
    index = nearest_point(queries, points).long().unsqueeze(-1).expand(-1, -1, 3)
    return (queries - points.gather(1, index)).norm(dim=-1)
