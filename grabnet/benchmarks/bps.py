"""Basis point features of objects in many poses."""

from __future__ import annotations

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from grabnet.benchmarks.run import BenchmarkConfig
from grabnet.benchmarks.scene import HandsOnObjects
from grabnet.benchmarks.timing import Case
from grabnet.geometry.bps import BPS
from grabnet.geometry.queries import MeshQuery

# Surface samples per object for the ways that encode point clouds.
N_SAMPLES = 10_000


def cases(settings: BenchmarkConfig) -> list[Case]:
    scene = HandsOnObjects.make(settings.batch, settings.seed, settings.device)
    bps = BPS().to(settings.device)
    samples = [mesh.sample_surface(N_SAMPLES)[0] for mesh in scene.meshes]
    trees = [cKDTree(points) for points in samples]
    clouds = [torch.tensor(s - m.centroid, device=settings.device) for s, m in zip(samples, scene.meshes, strict=True)]
    queries = [MeshQuery(mesh, settings.device) for mesh in scene.meshes]

    def by_cdist() -> list[Tensor]:
        pairs = zip(scene.objects.tolist(), scene.rotations, strict=True)
        return [bps.encode(clouds[item] @ rotation.mT)["dists"] for item, rotation in pairs]

    def by_tree() -> list[Tensor]:
        basis = bps.in_object_frame(scene.rotations, scene.centroids).cpu().numpy()
        pairs = zip(scene.objects.tolist(), basis, strict=True)
        return [torch.from_numpy(trees[item].query(points)[0]).float() for item, points in pairs]

    def by_query() -> list[Tensor]:
        poses = zip(scene.objects.tolist(), scene.rotations, scene.centroids, strict=True)
        return [bps.from_mesh(queries[item], rotation, centroid) for item, rotation, centroid in poses]

    return [
        Case("brute force over 10,000 samples", by_cdist),
        Case("KD-tree of 10,000 samples", by_tree, ("brute force over 10,000 samples",)),
        Case("exact mesh queries", by_query, ("KD-tree of 10,000 samples",)),
        Case(
            "atlas",
            lambda: scene.atlas.basis_distances(bps.basis, scene.objects, scene.rotations, scene.centroids),
            ("KD-tree of 10,000 samples",),
        ),
    ]
