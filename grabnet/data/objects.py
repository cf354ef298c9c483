"""The objects of a data set: meshes, their centres, surface samples and signed distances, indexed by number."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from grabnet.cli.progress import track
from grabnet.errors import UserError
from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.conventions import Conventions
from grabnet.geometry.mesh import Mesh, load_mesh
from grabnet.geometry.nearest import GROUP, by_neighbourhood
from grabnet.geometry.placed import PlacedObjects
from grabnet.geometry.sdf_grid import AtlasConfig, SDFGrid
from grabnet.io.files import existing, sha256
from grabnet.io.names import originals

OBJECT_MESHES = Path("tools/object_meshes/contact_meshes")  # GRAB's own layout, below its root
MESH_SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb", ".gltf")


class ObjectSet(nn.Module):
    """Geometry of `names`, in that order.

    Args:
        names: of the objects.
        meshes: one each, metres, in the object's own frame.
        conventions: how they are shown; `object_points` surface points are sampled of each.
        seed: of the sampling.
        cache_dir: where signed-distance grids are kept; the user's cache folder when omitted.

    Attributes:
        names, meshes: as given.
        centres (O, 3): point of each object at the origin of its world, object frame.
        offsets (O, 3): from the centre to the mean vertex, which frames stores have at the origin (ref. 3).
        points (O, object_points, 3): surface samples, object frame, relative to the centre; each 16 on end are
            neighbours, as `NearestVertex` likes it.
        atlas: signed distances.
    """

    def __init__(
        self,
        names: Sequence[str],
        meshes: Sequence[Mesh],
        conventions: Conventions | None = None,
        seed: int = 0,
        cache_dir: str | Path | None = None,
    ):
        super().__init__()
        self.names, self.meshes = list(names), list(meshes)
        self.sha256 = sha256(*(mesh.sha256 for mesh in meshes))
        known = conventions or Conventions()
        centres = _stacked([torch.as_tensor(known.centre_of(mesh)) for mesh in meshes])
        points = [torch.as_tensor(mesh.sample_surface(known.object_points, seed)[0]) for mesh in meshes]
        points = [of_one[by_neighbourhood(of_one, GROUP)] for of_one in points]
        vertices = [known.vertices_in_use(mesh) for mesh in meshes] if known.basis_to == "samples" else None
        self.register_buffer("centres", centres, False)
        self.register_buffer("offsets", _stacked([torch.as_tensor(mesh.centroid) for mesh in meshes]) - centres, False)
        self.register_buffer("points", _stacked(points) - centres.unsqueeze(1), False)
        self.register_buffer("basis_samples", None if vertices is None else _stacked(vertices), False)
        self.distances_to_points = known.distance_to == "samples"
        config = AtlasConfig(centre=known.centre)
        grids = [
            SDFGrid.load_or_build(mesh, cache_dir, config) for mesh in track(meshes, "Signed distances of the objects")
        ]
        self.atlas = SDFAtlas(grids)

    @classmethod
    def load(cls, folder: str | Path, names: Sequence[str], **options) -> ObjectSet:
        """Read `<folder>/<name>.<ply, obj, …>` for each name.

        Raises:
            UserError: no such folder, an object without a mesh, or an unreadable mesh.
        """
        files = object_files(folder)
        if missing := [name for name in names if name not in files]:
            raise UserError(f"{folder} has no mesh for {', '.join(missing)}; it has {', '.join(files) or 'none'}.")
        return cls(names, [load_mesh(files[name]) for name in names], **options)

    def place(self, index: Tensor, rotations: Tensor) -> PlacedObjects:
        """Objects `index` (B,) in a world about their centres, in which they are turned by `rotations` (B, 3, 3)."""
        samples = self.points if self.distances_to_points else None
        return PlacedObjects(self.atlas, index, rotations, self.centres[index], samples, self.basis_samples)

    def mean_vertices(self, index: Tensor, rotations: Tensor) -> Tensor:
        """(B, 3) mean vertices of the objects placed by `place`."""
        return (rotations @ self.offsets[index].unsqueeze(-1)).squeeze(-1)


def object_files(folder: str | Path) -> dict[str, Path]:
    """Mesh file of each object in a folder, by name.

    Raises:
        UserError: no such folder.
    """
    folder = existing(folder, "Object folder (objects.dir)")
    return {p.stem: p for p in originals(folder.iterdir(), folder) if p.suffix.lower() in MESH_SUFFIXES}


def _stacked(rows: Sequence[Tensor]) -> Tensor:
    return torch.stack([*rows]).float()
