"""Objects as convex pieces, by CoACD (Wei et al., SIGGRAPH 2022), found once per mesh."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import pyvista
from safetensors.numpy import load, save
from scipy.spatial import ConvexHull, QhullError

from grabnet.cli.checks import Count, Range, in_range
from grabnet.geometry.intersections import MovingMesh, find_crossings
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.io.cache import default_cache, load_or_build
from grabnet.io.files import sha256
from grabnet.io.tensors import read_facts
from grabnet.physics.coacd_process import CoacdError, cut

# Part of the cache key: raise it when the same mesh, config and version of CoACD would give other pieces.
FORMAT = 3


class DecompositionError(ValueError):
    """A mesh can't be cut into convex pieces; the message says why."""


@dataclass(frozen=True)
class DecompositionConfig:
    """How finely an object is cut; `physics` in `configs/evaluate.yaml` explains the values.

    Raises:
        UserError: a value out of range.
    """

    concavity: Annotated[float, Range(0.01, 1)]
    max_faces: Annotated[int, Range(100, 1_000_000)]
    max_corners: Annotated[int, Range(32, 65_536)]
    remeshing: Annotated[int, Range(1, 1000)]
    resolution: Count
    nodes: Count
    iterations: Count
    seed: Annotated[int, Range(0, 2**31 - 1)]
    time_limit: Annotated[float, Range(1)]

    def __post_init__(self):
        in_range(self, "physics.decomposition.")


def convex_pieces(mesh: Mesh, config: DecompositionConfig, cache_dir: str | Path | None = None) -> list[np.ndarray]:
    """The pieces of `decomposed` from the cache, or found and put there; that there are none is kept, too.

    Args:
        cache_dir: default `$GRABNET_CACHE`, else `grabnet` in the user's cache folder.

    Raises:
        DecompositionError: as `decomposed`.
    """
    settings = json.dumps(asdict(config), sort_keys=True)
    key = sha256(mesh.sha256, settings, version("coacd"), str(FORMAT))
    path = Path(cache_dir or default_cache()) / f"pieces-{key[:32]}.safetensors"

    def build() -> _Found:
        try:
            return _Found(decomposed(mesh, config), None)
        except DecompositionError as error:
            return _Found([], str(error))

    found = load_or_build(path, _decoded, build, _encoded)
    if found.refusal:
        raise DecompositionError(found.refusal)
    return found.pieces


def decomposed(mesh: Mesh, config: DecompositionConfig) -> list[np.ndarray]:
    """Corners (N, 3) float32 of convex solids that together approximate the inside of a mesh, in its frame and units.

    A mesh that doesn't bound a solid is remeshed by CoACD: parts that overlap are joined, and open walls become thin
    ones. The same mesh and config give the same pieces.

    Raises:
        DecompositionError: CoACD finds no pieces, or not in time.
    """
    solid = _solid(mesh, config.max_faces)
    surface = solid or mesh
    try:
        parts = cut(
            surface.vertices,
            surface.faces,
            config.time_limit,
            threshold=config.concavity,
            preprocess_mode="off" if solid else "on",
            preprocess_resolution=config.remeshing,
            resolution=config.resolution,
            mcts_nodes=config.nodes,
            mcts_iterations=config.iterations,
            seed=config.seed,
        )
    except CoacdError as error:
        raise DecompositionError(f"This mesh of {len(mesh.faces)} faces isn't cut: {error}; repair it.") from None
    directions = _directions(config.max_corners)
    pieces = [corners for part in parts if (corners := _corners(part, directions)) is not None]
    if not pieces:
        raise DecompositionError(f"CoACD finds no convex pieces in this mesh of {len(mesh.faces)} faces; repair it.")
    return pieces


def _solid(mesh: Mesh, max_faces: int) -> Mesh | None:
    """A mesh facing outward and, if that can be, of few faces; None where it doesn't bound a solid."""
    outward = mesh if mesh.volume > 0 else Mesh(mesh.vertices, mesh.faces[:, ::-1])
    candidates = (_simplified(outward, max_faces), outward)
    return next((candidate for candidate in candidates if _bounds_solid(candidate)), None)


def _simplified(mesh: Mesh, max_faces: int) -> Mesh:
    """The same with fewer faces."""
    if len(mesh.faces) <= max_faces:
        return mesh
    surface = pyvista.make_tri_mesh(mesh.vertices.astype(np.float64), mesh.faces)
    fewer = surface.decimate(1 - max_faces / len(mesh.faces))
    return Mesh(fewer.points, fewer.faces.reshape(-1, 4)[:, 1:])


def _bounds_solid(mesh: Mesh) -> bool:
    """Whether a mesh is closed, encloses something, and neither cuts itself nor has parts inside others.

    On surfaces that do, CoACD may never end.
    """
    if not mesh.is_closed or mesh.volume <= 0 or MeshQuery(mesh).overlaps:
        return False
    surface = MovingMesh(mesh.vertices, mesh.faces)
    crossings = find_crossings(surface, surface)
    apart = surface.edges[crossings.edge][:, :, None] != mesh.faces[crossings.face][:, None]
    return not apart.all((1, 2)).any()


def _corners(points: np.ndarray, directions: np.ndarray) -> np.ndarray | None:
    """Those of points (N, 3) that lie farthest out in any of directions (D, 3); None where they are flat."""
    corners = points[np.unique((points @ directions.T).argmax(0))]
    try:
        ConvexHull(corners.astype(np.float64))
    except QhullError:
        return None
    return corners


def _directions(n: int) -> np.ndarray:
    """(n, 3) unit vectors, spread evenly: Fibonacci's lattice."""
    i = np.arange(n) + 0.5
    z, angle = 1 - 2 * i / n, np.pi * (1 + 5**0.5) * i
    return np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], 1).astype(np.float32)


class _Found(NamedTuple):
    """Pieces, or why there are none."""

    pieces: list[np.ndarray]
    refusal: str | None


def _encoded(found: _Found) -> bytes:
    counts = np.array([len(piece) for piece in found.pieces], np.int64)
    corners = np.concatenate([np.empty((0, 3), np.float32), *found.pieces])
    return save({"corners": corners, "counts": counts}, {"refusal": found.refusal or ""})


def _decoded(content: bytes) -> _Found:
    arrays, refusal = load(content), read_facts(content)["refusal"]
    corners, counts = arrays["corners"], arrays["counts"]
    if corners.dtype != np.float32 or corners.shape != (counts.sum(), 3) or not (counts >= 4).all():
        raise ValueError(f"corners {corners.dtype} {corners.shape} of {counts.shape} pieces")
    return _Found(np.split(corners, np.cumsum(counts)[:-1]) if len(counts) else [], refusal or None)
