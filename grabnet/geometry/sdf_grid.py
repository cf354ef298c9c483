"""One object's signed-distance grid: building it from a mesh, and keeping it on disk."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load, save
from torch import Tensor

from grabnet.geometry.conventions import Conventions
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.sdf_sampling import sample
from grabnet.io.cache import default_cache, load_or_build
from grabnet.io.files import sha256
from grabnet.io.tensors import read_facts

# Part of the cache key: raise it when the same mesh and config would give other values.
FORMAT = 2


@dataclass(frozen=True)
class AtlasConfig:
    """How a mesh's signed distance is stored; lengths in metres."""

    fine_nodes: int = 128**3  # at most this many nodes around the object; 2 bytes each
    fine_pad: float = 0.02  # fine box beyond the mesh: fingers that touch it lie within
    fine_stride: int = 8  # nodes from one to the next of those sampled first: a power of 2
    coarse_nodes: int = 80**3  # at most this many in the wide box, where distance is long and smooth
    coarse_pad: float = 0.06  # wide box beyond the mesh
    coarse_radius: float = 0.16  # and at least this far from the centre: the BPS ball of 15 cm fits in any rotation
    centre: str = "mean_vertex"  # as in `Conventions`
    coarse_stride: int = 4
    exact_zone: float = 0.002  # nodes closer than this to the surface are queried exactly
    doubt: float = 0.0075  # nodes beyond the zone are interpolated unless two predictions differ by this share of them


@dataclass(frozen=True)
class Level:
    """Distances (nx, ny, nz) float16 at nodes `origin + spacing * (i, j, k)`, metres."""

    origin: tuple[float, float, float]
    spacing: float
    values: Tensor

    def __post_init__(self):
        if self.values.dtype != torch.float16 or self.values.dim() != 3 or min(self.values.shape) < 2:
            raise ValueError(f"a level is (nx, ny, nz) float16, not {tuple(self.values.shape)} {self.values.dtype}")


@dataclass(frozen=True)
class SDFGrid:
    """Signed distance of one object in its own frame, metres, negative inside."""

    fine: Level
    coarse: Level

    @property
    def levels(self) -> tuple[Level, Level]:
        return self.fine, self.coarse

    @classmethod
    def build(cls, mesh: Mesh, config: AtlasConfig | None = None, device: torch.device | str = "cpu") -> SDFGrid:
        """Sample the signed distance of `mesh`, closed or open; one or two seconds for 40,000 faces."""
        config = config or AtlasConfig()
        query = MeshQuery(mesh, device)
        (low, high), centre = mesh.bounds, Conventions(config.centre).centre_of(mesh)
        wide_low = np.minimum(low - config.coarse_pad, centre - config.coarse_radius)
        wide_high = np.maximum(high + config.coarse_pad, centre + config.coarse_radius)

        def level(low: np.ndarray, high: np.ndarray, nodes: int, stride: int, zone: float) -> Level:
            origin, spacing, dims = _lattice(low, high, nodes, stride)
            values = sample(query, origin.to(device), spacing, dims, stride, zone, config.doubt)
            return Level(tuple(origin.tolist()), spacing, values.cpu().half())

        fine_low, fine_high = low - config.fine_pad, high + config.fine_pad
        fine = level(fine_low, fine_high, config.fine_nodes, config.fine_stride, config.exact_zone)
        # The coarse level is not read near the surface.
        return cls(fine, level(wide_low, wide_high, config.coarse_nodes, config.coarse_stride, 0.0))

    @classmethod
    def load_or_build(
        cls,
        mesh: Mesh,
        cache_dir: str | Path | None = None,
        config: AtlasConfig | None = None,
        device: torch.device | str = "cpu",
    ) -> SDFGrid:
        """The grid of `mesh` from the cache, or built and put there.

        Args:
            cache_dir: default `$GRABNET_CACHE`, else `grabnet` in the user's cache folder.
        """
        config = config or AtlasConfig()
        key = sha256(mesh.sha256, json.dumps(asdict(config), sort_keys=True), str(FORMAT))
        path = Path(cache_dir or default_cache()) / f"sdf-{key[:32]}.safetensors"
        return load_or_build(path, cls.from_bytes, lambda: cls.build(mesh, config, device), cls.to_bytes)

    def to_bytes(self) -> bytes:
        """As a safetensors file."""
        levels = {"fine": self.fine, "coarse": self.coarse}
        lattices = {name: json.dumps([level.origin, level.spacing]) for name, level in levels.items()}
        return save({name: level.values for name, level in levels.items()}, lattices)

    @classmethod
    def from_bytes(cls, content: bytes) -> SDFGrid:
        """Read what `to_bytes` wrote.

        Raises:
            SafetensorError, KeyError, ValueError, TypeError: not such content.
        """
        values, lattices = load(content), read_facts(content)
        levels = []
        for name in ("fine", "coarse"):
            (x, y, z), spacing = json.loads(lattices[name])
            levels.append(Level((float(x), float(y), float(z)), float(spacing), values[name]))
        return cls(*levels)


def _lattice(low: np.ndarray, high: np.ndarray, nodes: int, stride: int) -> tuple[Tensor, float, tuple[int, int, int]]:
    """Origin, spacing and dims of the finest lattice of cubes over the box with at most `nodes` nodes."""
    sides = (high - low).astype(np.float64)
    spacing = (np.prod(sides) / nodes) ** (1 / 3)
    while np.prod((cells := np.ceil(sides / (spacing * stride)) * stride) + 1) > nodes:
        spacing *= 1.002
    origin = (low + high) / 2 - spacing * cells / 2
    return torch.tensor(origin, dtype=torch.float32), float(spacing), tuple(int(n) + 1 for n in cells)
