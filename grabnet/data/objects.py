"""The objects of a data set: meshes, their centroids, surface samples and signed distances, indexed by number."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from rich.progress import track
from torch import Tensor, nn

from grabnet.errors import UserError
from grabnet.geometry.atlas import SDFAtlas, SDFGrid
from grabnet.geometry.mesh import Mesh, load_mesh
from grabnet.geometry.nearest import GROUP, by_neighbourhood
from grabnet.geometry.placed import PlacedObjects
from grabnet.io.files import existing, sha256

OBJECT_MESHES = Path("tools/object_meshes/contact_meshes")  # GRAB's own layout, below its root
MESH_SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb", ".gltf")


class ObjectSet(nn.Module):
    """Geometry of `names`, in that order.

    Args:
        names: of the objects.
        meshes: one each, metres, in the object's own frame.
        n_points: surface points sampled per object (ref. 2: 2048).
        seed: of the sampling.
        cache_dir: where signed-distance grids are kept; the user's cache folder when omitted.
        distance_to: what the `distances` of placed objects are: to the "surface", signed, by the atlas; or unsigned to
            the nearest of the "samples", as published (ref. 2), by brute force.

    Raises:
        UserError: another `distance_to`.

    Attributes:
        names, meshes: as given.
        centroids (O, 3): mean of the mesh vertices (ref. 3), object frame.
        points (O, n_points, 3): surface samples, object frame, relative to the centroid; each 16 on end are neighbours,
            as `NearestVertex` likes it.
        atlas: signed distances.
    """

    def __init__(
        self,
        names: Sequence[str],
        meshes: Sequence[Mesh],
        n_points: int = 2048,
        seed: int = 0,
        cache_dir: str | Path | None = None,
        distance_to: str = "surface",
    ):
        super().__init__()
        if distance_to not in ("surface", "samples"):
            raise UserError(f"data.distance_to is '{distance_to}'; it can be surface or samples.")
        self.distance_to = distance_to
        self.names, self.meshes = list(names), list(meshes)
        self.sha256 = sha256(*(mesh.sha256 for mesh in meshes))
        centroids = torch.stack([torch.as_tensor(mesh.centroid, dtype=torch.float32) for mesh in meshes])
        points = [torch.as_tensor(mesh.sample_surface(n_points, seed)[0], dtype=torch.float32) for mesh in meshes]
        points = [of_one[by_neighbourhood(of_one, GROUP)] for of_one in points]
        self.register_buffer("centroids", centroids, False)
        self.register_buffer("points", torch.stack(points) - centroids.unsqueeze(1), False)
        grids = [
            SDFGrid.load_or_build(mesh, cache_dir)
            for mesh in track(meshes, "Signed distances of the objects", transient=True)
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
        """Objects `index` (B,) in a world about their centroids, in which they are turned by `rotations` (B, 3, 3)."""
        samples = self.points if self.distance_to == "samples" else None
        return PlacedObjects(self.atlas, index, rotations, self.centroids[index], samples)


def object_files(folder: str | Path) -> dict[str, Path]:
    """Mesh file of each object in a folder, by name.

    Raises:
        UserError: no such folder.
    """
    folder = existing(folder, "Object folder (objects.dir)")
    return {p.stem: p for p in sorted(folder.iterdir()) if p.suffix.lower() in MESH_SUFFIXES}
