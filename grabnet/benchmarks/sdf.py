"""Signed distance of hand vertices to objects: with the gradient, as training needs it; and building a grid."""

from __future__ import annotations

import torch
from torch import Tensor

from grabnet.benchmarks.run import BenchmarkConfig
from grabnet.benchmarks.scene import HandsOnObjects
from grabnet.benchmarks.timing import Case
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.sdf_grid import AtlasConfig, SDFGrid

# Points per object that the published training compares each hand vertex with (ref. 2).
N_OBJECT_POINTS = 2048
FULL = AtlasConfig()
# Small enough for the plain way to build it, too.
SMALL = AtlasConfig(fine_nodes=64**3, coarse_nodes=40**3)


def cases(settings: BenchmarkConfig) -> list[Case]:
    scene = HandsOnObjects.make(settings.batch, settings.seed, settings.device)
    queries = [MeshQuery(mesh, settings.device) for mesh in scene.meshes]
    samples = [mesh.sample_surface(N_OBJECT_POINTS)[0] for mesh in scene.meshes]
    clouds = torch.stack([torch.tensor(sample) for sample in samples]).to(scene.objects.device)[scene.objects]
    mesh = scene.meshes[1]

    def differentiate(distance) -> Tensor:
        points = scene.vertices.clone().requires_grad_()
        distance(points).sum().backward()
        return points.grad

    def exact(points: Tensor) -> Tensor:
        pairs = zip(points, scene.objects.tolist(), strict=True)
        closest = torch.stack([queries[item].closest(p).position for p, item in pairs])
        return (points - closest).norm(dim=-1)

    def nearest_sample(points: Tensor) -> Tensor:
        return torch.cdist(points, clouds).amin(-1)

    nearest = "nearest of 2048 samples"
    return [
        Case(nearest, lambda: differentiate(nearest_sample)),
        Case("exact mesh queries", lambda: differentiate(exact), (nearest,)),
        Case(
            "atlas lookup",
            lambda: differentiate(lambda p: scene.atlas(p, scene.objects)),
            (nearest,),
        ),
        Case("small grid, exact at every node", lambda: _exact_grid(mesh, settings.device)),
        Case("small grid", lambda: SDFGrid.build(mesh, SMALL, settings.device), ("small grid, exact at every node",)),
        Case(f"full grid ({len(mesh.faces)} faces)", lambda: SDFGrid.build(mesh, FULL, settings.device)),
    ]


def _exact_grid(mesh: Mesh, device: str) -> None:
    query = MeshQuery(mesh, device)
    for nodes in (SMALL.fine_nodes, SMALL.coarse_nodes):
        low, high = torch.tensor(mesh.bounds, device=device)
        query.signed_distance(low + (high - low) * torch.rand(nodes, 3, device=device))
