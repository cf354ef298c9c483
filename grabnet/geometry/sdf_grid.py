"""One object's signed-distance grid: building it from a mesh, and keeping it on disk."""

from __future__ import annotations

import json
import os
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from grabnet.files import replacing, sha256
from grabnet.geometry.mesh import Mesh

# Part of the cache key: raise it when the same mesh and config would give other values.
FORMAT = 1


@dataclass(frozen=True)
class AtlasConfig:
    """How a mesh's signed distance is stored; lengths in metres."""

    fine_nodes: int = 128**3  # at most this many nodes around the object; 2 bytes each
    coarse_nodes: int = 64**3  # at most this many in the wide box, where distance is long and smooth
    fine_pad: float = 0.02  # fine box beyond the mesh: fingers that touch it lie within
    coarse_pad: float = 0.06  # coarse box beyond the mesh
    coarse_radius: float = 0.16  # and at least this far from the centroid: the BPS ball of 15 cm fits in any rotation
    exact_zone: float = 0.005  # nodes closer than this to the surface are queried exactly
    stride: int = 4  # nodes between those of the first, exact lattice: a power of 2
    doubt: float = 0.005  # nodes beyond the zone are interpolated unless two predictions differ by this share of them


@dataclass(frozen=True)
class Level:
    """Distances (nx, ny, nz) float16 at nodes `origin + spacing * (i, j, k)`, metres."""

    origin: tuple[float, float, float]
    spacing: float
    values: Tensor


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
        # Here and not above: warp takes a second to start, which a grid read from the cache need not wait for.
        from grabnet.geometry.queries import MeshQuery
        from grabnet.geometry.sdf_sampling import sample

        config = config or AtlasConfig()
        query = MeshQuery(mesh, device)
        low, high = mesh.bounds
        boxes = {
            config.fine_nodes: (low - config.fine_pad, high + config.fine_pad),
            config.coarse_nodes: (
                np.minimum(low - config.coarse_pad, mesh.centroid - config.coarse_radius),
                np.maximum(high + config.coarse_pad, mesh.centroid + config.coarse_radius),
            ),
        }
        levels = []
        for nodes, (low, high) in boxes.items():
            origin, spacing, dims = _lattice(low, high, nodes, config.stride)
            zone = max(config.exact_zone, 2 * spacing)
            values = sample(query, origin.to(device), spacing, dims, config.stride, zone, config.doubt)
            levels.append(Level(tuple(origin.tolist()), spacing, values.cpu().half()))
        return cls(*levels)

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
        if path.exists():
            try:
                return cls.load(path)
            except (SafetensorError, OSError, KeyError, ValueError) as error:
                warnings.warn(f"The cached grid {path} is damaged ({error}); it is built anew.", stacklevel=2)
        grid = cls.build(mesh, config, device)
        grid.save(path)
        return grid

    def save(self, path: str | Path) -> None:
        """Write as safetensors, atomically."""
        meta = {
            name: json.dumps([level.origin, level.spacing]) for name, level in zip(_NAMES, self.levels, strict=True)
        }
        with replacing(path) as temporary:
            save_file({name: level.values for name, level in zip(_NAMES, self.levels, strict=True)}, temporary, meta)

    @classmethod
    def load(cls, path: str | Path) -> SDFGrid:
        """Read what `save` wrote."""
        with safe_open(path, "pt") as file:
            meta = file.metadata() or {}
            levels = []
            for name in _NAMES:
                origin, spacing = json.loads(meta[name])
                levels.append(Level(tuple(origin), spacing, file.get_tensor(name)))
        return cls(*levels)


_NAMES = ("fine", "coarse")


def default_cache() -> Path:
    """Folder for what can be computed again: `$GRABNET_CACHE`, or `grabnet` in the user's cache folder."""
    if chosen := os.environ.get("GRABNET_CACHE"):
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "grabnet"


def _lattice(low: np.ndarray, high: np.ndarray, nodes: int, stride: int) -> tuple[Tensor, float, tuple[int, int, int]]:
    """Origin, spacing and dims of the finest lattice of cubes over the box with at most `nodes` nodes."""
    sides = (high - low).astype(np.float64)
    spacing = (np.prod(sides) / nodes) ** (1 / 3)
    while np.prod((cells := np.ceil(sides / (spacing * stride)) * stride) + 1) > nodes:
        spacing *= 1.002
    origin = (low + high) / 2 - spacing * cells / 2
    return torch.tensor(origin, dtype=torch.float32), float(spacing), tuple(int(n) + 1 for n in cells)
