"""Primitive solids: balls, boxes, round cones; outlines turned, pushed out or swept along a curve. Metres throughout."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import PchipInterpolator, make_interp_spline

from grabnet.open.objects.solid import FILLET, Array, Solid, as_points, pruned

Point = Sequence[float]


def sphere(radius: float) -> Solid:
    return Solid(lambda p: np.linalg.norm(p, axis=-1) - radius, np.full(3, -radius), np.full(3, radius))


def ellipsoid(x: float, y: float, z: float) -> Solid:
    """Semi-axes x, y, z. First-order distance: exact on the surface, scaled off it."""
    axes = np.array([x, y, z])

    def distance(p: Array) -> Array:
        scaled = np.linalg.norm(p / axes, axis=-1)
        return scaled * (scaled - 1) / np.maximum(np.linalg.norm(p / axes**2, axis=-1), 1e-12)

    return Solid(distance, -axes, axes)


def box(x: float, y: float, z: float, rounding: float = FILLET) -> Solid:
    """Full side lengths; edges rounded."""
    half = np.array([x, y, z]) / 2

    def distance(p: Array) -> Array:
        outside = np.abs(p) - (half - rounding)
        return np.linalg.norm(np.maximum(outside, 0), axis=-1) + np.minimum(outside.max(-1), 0) - rounding

    return Solid(distance, -half, half)


def cylinder(radius: float, height: float, rounding: float = FILLET) -> Solid:
    """About z, centred."""

    def distance(p: Array) -> Array:
        return _pushed(np.hypot(p[:, 0], p[:, 1]) - radius, p[:, 2], height, rounding)

    half = np.array([radius, radius, height / 2])
    return Solid(distance, -half, half)


def torus(ring: float, tube: float) -> Solid:
    """About z; `ring` is the radius of the tube's centre line."""
    half = np.array([ring + tube, ring + tube, tube])
    return Solid(lambda p: np.hypot(np.hypot(p[:, 0], p[:, 1]) - ring, p[:, 2]) - tube, -half, half)


def capsule(a: Point, b: Point, radius: float, end_radius: float | None = None) -> Solid:
    """Round cone from a ball at `a` to a ball at `b`."""
    return sweep([a, b], [radius, radius if end_radius is None else end_radius], smooth=False)


def sweep(points: Sequence[Point], radii: float | Sequence[float], smooth: bool = True, pieces: int = 24) -> Solid:
    """Round tube along a curve through `points` (N, 3), its radius interpolated; a spline when `smooth`."""
    path = as_points(points)
    radius = np.broadcast_to(np.asarray(radii, float), len(path)).copy()
    if smooth and len(path) > 2:
        path, radius = _resampled(path, radius, pieces)
    start, axis, thin, growth = path[:-1], np.diff(path, axis=0), radius[:-1], np.diff(radius)

    def distance(p: Array) -> Array:
        best = np.full(len(p), np.inf)
        for a, u, r, dr in zip(start, axis, thin, growth, strict=True):
            t = np.clip((p - a) @ u / max(u @ u, 1e-18), 0, 1)
            np.minimum(best, np.linalg.norm(p - a - t[:, None] * u, axis=-1) - (r + t * dr), out=best)
        return best

    return pruned(Solid(distance, (path - radius[:, None]).min(0), (path + radius[:, None]).max(0)))


def lathe(profile: Sequence[Point], rounding: float = 0.0, smooth: bool = False) -> Solid:
    """Closed outline of (radius, z) points turned about z; on the axis it may touch radius 0."""
    outline = _smoothed_outline(profile) if smooth else as_points(profile)
    top = np.array([outline[:, 0].max()] * 2 + [outline[:, 1].max()])
    bottom = np.array([-outline[:, 0].max()] * 2 + [outline[:, 1].min()])

    def distance(p: Array) -> Array:
        radial = np.stack([np.hypot(p[:, 0], p[:, 1]), p[:, 2]], -1)
        return _outline_distance(radial, outline, on_axis=True) - rounding

    return pruned(Solid(distance, bottom - rounding, top + rounding))


def loft(stations: Sequence[Point], rounding: float = 0.002) -> Solid:
    """Elliptic sections along x: rows of (x, half width in y, half height in z), interpolated without overshoot."""
    x, width, height = as_points(stations).T
    width_at, height_at = PchipInterpolator(x, width), PchipInterpolator(x, height)

    def distance(p: Array) -> Array:
        along = np.clip(p[:, 0], x[0], x[-1])
        axes = np.stack([width_at(along), height_at(along)], -1)
        scaled = np.linalg.norm(p[:, 1:] / axes, axis=-1)
        side = scaled * (scaled - 1) / np.maximum(np.linalg.norm(p[:, 1:] / axes**2, axis=-1), 1e-12) + rounding
        end = np.abs(p[:, 0] - (x[0] + x[-1]) / 2) - (x[-1] - x[0]) / 2 + rounding
        return np.hypot(np.maximum(side, 0), np.maximum(end, 0)) + np.minimum(np.maximum(side, end), 0) - rounding

    half = np.array([width.max(), height.max()])
    return pruned(Solid(distance, np.array([x[0], *-half]), np.array([x[-1], *half])))


def extruded(outline: Sequence[Point], height: float, rounding: float = FILLET, smooth: bool = False) -> Solid:
    """Closed (x, y) outline pushed out along z, centred, edges rounded; a closed spline when `smooth`."""
    polygon = _smoothed_outline(outline) if smooth else as_points(outline)

    def distance(p: Array) -> Array:
        return _pushed(_outline_distance(p[:, :2], polygon), p[:, 2], height, rounding)

    return pruned(Solid(distance, np.array([*polygon.min(0), -height / 2]), np.array([*polygon.max(0), height / 2])))


def _pushed(flat: Array, z: Array, height: float, rounding: float) -> Array:
    """Distance to a 2-D shape (given its distance `flat`) pushed to `height`, its outer edges rounded."""
    side, end = flat + rounding, np.abs(z) - (height / 2 - rounding)
    return np.hypot(np.maximum(side, 0), np.maximum(end, 0)) + np.minimum(np.maximum(side, end), 0) - rounding


def _outline_distance(p: Array, outline: Array, on_axis: bool = False) -> Array:
    """Signed distance of (N, 2) points to a closed polygon (M, 2); edges on x = 0 are no wall when `on_axis`."""
    best = np.full(len(p), np.inf)
    inside = np.zeros(len(p), bool)
    for a, b in zip(outline, np.roll(outline, -1, 0), strict=True):
        if (a[1] > b[1]) != (b[1] > a[1]) and a[1] != b[1]:
            rising = (a[1] > p[:, 1]) != (b[1] > p[:, 1])
            inside ^= rising & (p[:, 0] < a[0] + (p[:, 1] - a[1]) * (b[0] - a[0]) / (b[1] - a[1]))
        if on_axis and a[0] == b[0] == 0:
            continue
        u = b - a
        t = np.clip((p - a) @ u / max(u @ u, 1e-18), 0, 1)
        off = p - a - t[:, None] * u
        np.minimum(best, off[:, 0] ** 2 + off[:, 1] ** 2, out=best)
    return np.where(inside, -1, 1) * np.sqrt(best)


def _resampled(path: Array, radius: Array, pieces: int) -> tuple[Array, Array]:
    """Cubic spline through the points by chord length; radii without overshoot."""
    knots = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=-1))])
    t = np.linspace(0, knots[-1], pieces + 1)
    return make_interp_spline(knots, path, k=min(3, len(path) - 1))(t), PchipInterpolator(knots, radius)(t)


def _smoothed_outline(outline: Sequence[Point], pieces: int = 48) -> Array:
    """Closed periodic spline through the points."""
    closed = as_points([*outline, outline[0]])
    knots = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=-1))])
    spline = make_interp_spline(knots, closed, k=3, bc_type="periodic")
    return spline(np.linspace(0, knots[-1], pieces, endpoint=False))
