"""The open objects as synthesis grasps them: with the parts at which people take each."""

from __future__ import annotations

from pathlib import Path

from grabnet.grasping.proposing.grasped_object import GraspedObject, part
from grabnet.open.objects import build_object, prop


def open_object(
    name: str, surface_points: int = 6000, seed: int = 0, cache_dir: str | Path | None = None
) -> GraspedObject:
    """The open object of that name.

    Args:
        surface_points: samples of each part's surface.
        seed: of these.
        cache_dir: of signed-distance grids, as in `SDFGrid.load_or_build`.
    """
    mesh, regions = build_object(name), prop(name).regions
    parts = [part(mesh, r.low, r.high, r.weight, surface_points, seed) for r in regions]
    rest = 1.0 - sum(p.weight for p in parts)
    if rest > 1e-6:
        parts.append(part(mesh, *mesh.bounds, rest, surface_points, seed))
    return GraspedObject(name, mesh, parts, cache_dir)
