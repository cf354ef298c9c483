"""Intersection volume of hands and an object, against asking for each voxel of their boxes' overlap by itself."""

from __future__ import annotations

import numpy as np
import torch

from grabnet.benchmarks.run import BenchmarkConfig
from grabnet.benchmarks.scene import hands, meshes
from grabnet.benchmarks.timing import Case
from grabnet.evaluation.hands import Hands
from grabnet.evaluation.scene import GraspScene, GraspTarget
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery

SPACING = 0.001  # metres
_MOST = 8  # hands; the plain way takes a second and a half for each


def cases(settings: BenchmarkConfig) -> list[Case]:
    target = GraspTarget(meshes()[0])
    n = min(settings.batch, _MOST)
    model, parameters = hands(n, torch.Generator().manual_seed(settings.seed), "cpu")
    posed = Hands(vertices=0.6 * model(parameters).vertices.numpy(), faces=model.faces.numpy())
    query = MeshQuery(target.mesh)
    plain = f"each voxel by rays and winding number ({len(posed)} hands)"
    return [
        Case(plain, lambda: _plain(target.mesh, query, posed), runs=2),
        Case(
            f"whole columns ({len(posed)} hands)",
            lambda: GraspScene(target, Hands(vertices=posed.vertices, faces=posed.faces)).shared_volume(SPACING),
            (plain,),
        ),
        Case("voxels of an object not met before", lambda: GraspTarget(target.mesh).voxels(SPACING)),
    ]


def _plain(solid: Mesh, query: MeshQuery, posed: Hands) -> list[int]:
    vertices, faces = posed.closed
    counts = []
    for hand in vertices:
        low = np.floor(np.maximum(hand.min(0), solid.bounds[0]) / SPACING).astype(int)
        high = np.floor(np.minimum(hand.max(0), solid.bounds[1]) / SPACING).astype(int) + 1
        if (high <= low).any():
            counts.append(0)
            continue
        index = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), -1).reshape(-1, 3)
        points = torch.tensor((index + 0.5) * SPACING, dtype=torch.float32)
        points = points[query.signed_distance(points) < 0]
        counts.append(int((MeshQuery(Mesh(hand, faces)).signed_distance(points) < 0).sum()) if len(points) else 0)
    return counts
