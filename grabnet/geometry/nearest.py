"""Exact distances to points: to the vertices of a mesh that deforms, such as a posed hand, or to any cloud."""

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor, nn

from grabnet.geometry import nearest_kernels as kernels
from grabnet.geometry.warping import launch

# Vertices searched together. With more, groups are passed over less often; with fewer, there are more of them.
_GROUP_SIZE = 32


class NearestVertex(nn.Module):
    """Finds nearest vertices on poses of one mesh.

    Args:
        rest: (V, 3) vertices in some pose; those close together in it are searched together.
        faces: (F, 3) int, oriented outwards.
    """

    def __init__(self, rest: Tensor, faces: Tensor):
        super().__init__()
        groups = _groups(rest, _GROUP_SIZE)
        corners = faces.flatten().argsort(stable=True)
        around = torch.bincount(faces.flatten(), minlength=len(rest))

        def buffer(name: str, value: Tensor) -> None:
            self.register_buffer(name, value.int().contiguous(), persistent=False)

        buffer("faces", faces)
        buffer("members", torch.cat(groups))
        buffer("group_start", _starts(torch.tensor([len(g) for g in groups])))
        buffer("around", corners // 3)
        buffer("around_start", _starts(around))

    @torch.no_grad()
    def forward(self, queries: Tensor, vertices: Tensor) -> tuple[Tensor, Tensor]:
        """Nearest of the vertices (B, V, 3) to each of queries (B, Q, 3).

        Returns:
            its index (B, Q) int64, and whether the query lies behind the surface there (B, Q): against the vertex's
            normal, the sum of its faces' normals weighted by area.
        """
        queries, vertices = queries.float().contiguous(), vertices.float().contiguous()
        balls = queries.new_empty(len(vertices), len(self.group_start) - 1, 4)
        index = torch.empty(queries.shape[:2], dtype=torch.int32, device=queries.device)
        behind = torch.empty(queries.shape[:2], dtype=torch.bool, device=queries.device)
        topology = self._topology()
        launch(kernels.bound, [vertices, balls], [topology], width=balls.shape[1])
        launch(kernels.nearest_vertex, [vertices, balls, queries, index, behind], [topology], width=queries.shape[1])
        return index.long(), behind

    def signed_offset(self, queries: Tensor, vertices: Tensor) -> Tensor:
        """Distance (B, Q) of queries (B, Q, 3) to the nearest of vertices (B, V, 3), negative behind the surface.

        Differentiable in both.
        """
        index, behind = self(queries, vertices)
        offset = queries - vertices.gather(1, index.unsqueeze(-1).expand(-1, -1, 3))
        distance = (offset.square().sum(-1) + 1e-12).sqrt()  # a gradient at distance 0 too
        return torch.where(behind, -distance, distance)

    def _topology(self) -> kernels.Topology:
        topology = kernels.Topology()
        for name, variable in kernels.Topology.vars.items():
            setattr(topology, name, wp.from_torch(getattr(self, name), dtype=variable.type.dtype))
        return topology


@torch.no_grad()
def nearest_point(queries: Tensor, points: Tensor, chunk: int = 32) -> Tensor:
    """Index (B, Q) of the nearest of points (B, N, 3) to each of queries (B, Q, 3), by brute force.

    Args:
        chunk: batch elements whose Q x N distances are held at a time.
    """
    pieces = zip(queries.split(chunk), points.split(chunk), strict=True)
    return torch.cat([torch.cdist(q, p).argmin(-1) for q, p in pieces])


def nearest_point_distance(queries: Tensor, points: Tensor) -> Tensor:
    """Distance (B, Q) of queries (B, Q, 3) to the nearest of points (B, N, 3), by brute force; differentiable."""
    index = nearest_point(queries, points).unsqueeze(-1).expand(-1, -1, 3)
    return (queries - points.gather(1, index)).norm(dim=-1)


def _groups(points: Tensor, size: int) -> list[Tensor]:
    """Numbers of the points (N, 3) in groups of at most `size`, halved across their longest side again and again."""
    groups, large = [], [torch.arange(len(points), device=points.device)]
    while large:
        group = large.pop()
        if len(group) <= size:
            groups.append(group)
            continue
        sides = points[group].amax(0) - points[group].amin(0)
        order = group[points[group, sides.argmax()].argsort()]
        large += [order[: len(order) // 2], order[len(order) // 2 :]]
    return groups


def _starts(counts: Tensor) -> Tensor:
    return torch.cat([counts.new_zeros(1), counts.cumsum(0)])
