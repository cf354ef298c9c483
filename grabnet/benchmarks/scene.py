"""What the suites work on: open hands around objects of a few shapes, without any file but the hand's."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import trimesh
from torch import Tensor

from grabnet.body.hand import HandModel, HandParameters
from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.rotations import axis_angle_to_matrix, random_rotations
from grabnet.geometry.sdf_grid import SDFGrid


def meshes() -> list[Mesh]:
    """A ball, a ring, a bar and a tube of graspable size, 20,000 to 70,000 even faces each."""
    bar = trimesh.creation.box((0.2, 0.03, 0.02))
    solids = [
        trimesh.creation.icosphere(subdivisions=5, radius=0.04),
        trimesh.creation.torus(0.04, 0.012, major_sections=200, minor_sections=100),
        trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(bar.vertices, bar.faces, 0.0015)),
        trimesh.creation.annulus(0.035, 0.038, 0.1, sections=128).subdivide().subdivide().subdivide(),
    ]
    return [Mesh(solid.vertices, solid.faces) for solid in solids]


def hands(batch: int, generator: torch.Generator, device: str) -> tuple[HandModel, HandParameters]:
    """The open hand, and a batch of poses 10 cm from the origin."""
    parameters = HandParameters(
        random_rotations(batch, generator),
        axis_angle_to_matrix(0.3 * torch.randn(batch, 15, 3, generator=generator)),
        0.1 * torch.nn.functional.normalize(torch.randn(batch, 3, generator=generator), dim=1),
    )
    return HandModel.open().to(device), HandParameters(*(x.to(device) for x in parameters))


@dataclass(frozen=True)
class HandsOnObjects:
    """A batch of hands around objects.

    vertices: (B, 778, 3) in the frames of objects (B,), which index meshes. rotations: (B, 3, 3) of the objects.
    centroids: (B, 3) of the objects in their own frames.
    """

    meshes: list[Mesh]
    atlas: SDFAtlas
    vertices: Tensor
    objects: Tensor
    rotations: Tensor
    centroids: Tensor

    @classmethod
    def make(cls, batch: int, seed: int, device: str) -> HandsOnObjects:
        generator = torch.Generator().manual_seed(seed)
        solids = meshes()
        objects = torch.randint(len(solids), (batch,), generator=generator).to(device)
        rotations = random_rotations(batch, generator).to(device)
        centroids = torch.stack([torch.tensor(mesh.centroid) for mesh in solids]).to(device)[objects]
        hand, parameters = hands(batch, generator, device)
        with torch.no_grad():
            vertices = hand(parameters).vertices + centroids.unsqueeze(1)
        atlas = SDFAtlas([SDFGrid.load_or_build(mesh) for mesh in solids]).to(device)
        return cls(solids, atlas, vertices, objects, rotations, centroids)
