"""Exact distances to points: to the vertices of a mesh that deforms, such as a posed hand, or to any cloud."""

from __future__ import annotations

import torch
import warp as wp
from scipy.spatial import cKDTree
from torch import Tensor, nn

from grabnet.geometry.kernels import nearest as kernels
from grabnet.geometry.kernels.launch import launch

# Distances of pairs that a GPU holds at a time: 256 MiB.
_HELD_DISTANCES = 1 << 26


class NearestVertex(nn.Module):
    """Finds nearest vertices on poses of one mesh.

    Args:
        faces: (F, 3) int, oriented outwards.
        n_vertices: V.
    """

    def __init__(self, faces: Tensor, n_vertices: int):
        super().__init__()
        corners = faces.flatten().argsort(stable=True)
        opposite = torch.stack([faces.roll(-1, 1), faces.roll(-2, 1)], -1).flatten(0, 1)[corners]
        counts = torch.bincount(faces.flatten(), minlength=n_vertices)
        self.register_buffer("opposite", opposite.int().contiguous(), False)
        self.register_buffer("start", torch.cat([counts.new_zeros(1), counts.cumsum(0)]).int(), False)

    @torch.no_grad()
    def forward(self, queries: Tensor, vertices: Tensor) -> tuple[Tensor, Tensor]:
        """Nearest of the vertices (B, V, 3) to each of queries (B, Q, 3).

        Returns:
            its index (B, Q) int64, and whether the query lies behind the surface there (B, Q): against the vertex's
            normal, the sum of its faces' normals weighted by area.
        """
        queries, vertices = queries.float().contiguous(), vertices.float().contiguous()
        index = torch.empty(queries.shape[:2], dtype=torch.int32, device=queries.device)
        behind = torch.empty(queries.shape[:2], dtype=torch.bool, device=queries.device)
        items = [vertices, vertices.mT.contiguous(), queries, index, behind]
        launch(kernels.nearest_vertex, items, [self._topology()], width=queries.shape[1])
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


def cloud_distance(queries: Tensor, clouds: Tensor, index: Tensor) -> Tensor:
    """Distance (B, Q) of queries (B, Q, 3) to the nearest point of clouds[index]; differentiable in the queries.

    Args:
        clouds: (O, N, 3) points of O objects.
        index: (B,) int64, the object of each element.
    """
    find = _nearest_by_force if queries.is_cuda else _nearest_by_tree
    nearest = find(queries.detach(), clouds, index)
    return (queries - clouds[index.unsqueeze(1), nearest]).norm(dim=-1)


def _nearest_by_force(queries: Tensor, clouds: Tensor, index: Tensor) -> Tensor:
    """Number (B, Q) of the nearest point of its cloud: what suits a GPU."""
    chunk = max(1, _HELD_DISTANCES // max(1, queries.shape[1] * clouds.shape[1]))
    exact = "donot_use_mm_for_euclid_dist"
    pieces = zip(queries.split(chunk), index.split(chunk), strict=True)
    return torch.cat([torch.cdist(q, clouds[number], compute_mode=exact).argmin(-1) for q, number in pieces])


def _nearest_by_tree(queries: Tensor, clouds: Tensor, index: Tensor) -> Tensor:
    """The same on a CPU, where trees are faster by an order of magnitude."""
    nearest = torch.empty(queries.shape[:2], dtype=torch.int64)
    for number in index.unique().tolist():
        # Balanced, it recurses without end where a training flushes denormals: the number after 0 is 0 there.
        rows, tree = index == number, cKDTree(clouds[number].numpy(), balanced_tree=False)
        # A tree refuses what is not finite, which a training that diverges has to get through.
        _, found = tree.query(queries[rows].nan_to_num().numpy(), workers=torch.get_num_threads())
        nearest[rows] = torch.from_numpy(found)
    return nearest
