"""Primitive solids: balls, boxes, round cones; outlines turned, pushed out, swept along a curve. All in metres."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.interpolate import PchipInterpolator, make_interp_spline
from scipy.ndimage import map_coordinates

from grabnet.open.objects.solid import FILLET, REACH, Array, Solid, as_points, length, pruned

Point = Sequence[float]


def sphere(radius: float) -> Solid:
    return Solid(lambda p: length(p) - radius, np.full(3, -radius), np.full(3, radius))


def ellipsoid(x: float, y: float, z: float) -> Solid:
    """Semi-axes x, y, z. First-order distance: exact on the surface, scaled off it."""
    axes = np.array([x, y, z])

    def distance(p: Array) -> Array:
        scaled = length(p / axes)
        return scaled * (scaled - 1) / np.maximum(length(p / axes**2), 1e-12)

    return Solid(distance, -axes, axes)


def box(x: float, y: float, z: float, rounding: float = FILLET) -> Solid:
    """Full side lengths; edges rounded."""
    half = np.array([x, y, z]) / 2

    def distance(p: Array) -> Array:
        outside = np.abs(p) - (half - rounding)
        return length(np.maximum(outside, 0)) + np.minimum(outside.max(-1), 0) - rounding

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
            np.minimum(best, length(p - a - t[:, None] * u) - (r + t * dr), out=best)
        return best

    return pruned(Solid(distance, (path - radius[:, None]).min(0), (path + radius[:, None]).max(0)))


def lathe(profile: Sequence[Point], rounding: float = 0.0, smooth: bool = False) -> Solid:
    """Closed outline of (radius, z) points turned about z, its blunt corners curved when `smooth`."""
    outline = _smoothed(profile) if smooth else as_points(profile)
    top = np.array([outline[:, 0].max()] * 2 + [outline[:, 1].max()])
    bottom = np.array([-outline[:, 0].max()] * 2 + [outline[:, 1].min()])

    flat = _tabulated(outline, on_axis=True)

    def distance(p: Array) -> Array:
        return flat(np.hypot(p[:, 0], p[:, 1]), p[:, 2]) - rounding

    return pruned(Solid(distance, bottom - rounding, top + rounding))


def loft(stations: Sequence[Point], rounding: float = 0.002) -> Solid:
    """Elliptic sections along x: rows of (x, half width in y, half height in z), interpolated without overshoot."""
    x, width, height = as_points(stations).T
    width_at, height_at = PchipInterpolator(x, width), PchipInterpolator(x, height)

    def distance(p: Array) -> Array:
        along = np.clip(p[:, 0], x[0], x[-1])
        axes = np.stack([width_at(along), height_at(along)], -1)
        scaled = length(p[:, 1:] / axes)
        side = scaled * (scaled - 1) / np.maximum(length(p[:, 1:] / axes**2), 1e-12) + rounding
        end = np.abs(p[:, 0] - (x[0] + x[-1]) / 2) - (x[-1] - x[0]) / 2 + rounding
        return np.hypot(np.maximum(side, 0), np.maximum(end, 0)) + np.minimum(np.maximum(side, end), 0) - rounding

    half = np.array([width.max(), height.max()])
    return pruned(Solid(distance, np.array([x[0], *-half]), np.array([x[-1], *half])))


def extruded(outline: Sequence[Point], height: float, rounding: float = FILLET, smooth: bool = False) -> Solid:
    """Closed (x, y) outline pushed out along z, centred, edges rounded; blunt corners curved when `smooth`."""
    polygon = _smoothed(outline) if smooth else as_points(outline)

    flat = _tabulated(polygon)

    def distance(p: Array) -> Array:
        return _pushed(flat(p[:, 0], p[:, 1]), p[:, 2], height, rounding)

    return pruned(Solid(distance, np.array([*polygon.min(0), -height / 2]), np.array([*polygon.max(0), height / 2])))


def _pushed(flat: Array, z: Array, height: float, rounding: float) -> Array:
    """Distance to a 2-D shape (given its distance `flat`) pushed to `height`, its outer edges rounded."""
    side, end = flat + rounding, np.abs(z) - (height / 2 - rounding)
    return np.hypot(np.maximum(side, 0), np.maximum(end, 0)) + np.minimum(np.maximum(side, end), 0) - rounding


def _tabulated(outline: Array, on_axis: bool = False, step: float = 0.0004) -> Callable[[Array, Array], Array]:
    """Signed distance to a closed outline (M, 2), read from a table of pitch `step` as wide as `pruned` needs.

    Linear between the nodes: 20 µm off at a bend of 1 mm radius, and many times faster than M segments a point.
    """
    low, high = outline.min(0) - REACH - step, outline.max(0) + REACH + step
    if on_axis:
        low[0] = 0
    count = np.ceil((high - low) / step).astype(int) + 1
    nodes = np.stack(np.meshgrid(*(low[i] + step * np.arange(count[i]) for i in range(2)), indexing="ij"), -1)
    table = _outline_distance(nodes.reshape(-1, 2), outline, on_axis).reshape(count)
    return lambda x, y: map_coordinates(table, [(x - low[0]) / step, (y - low[1]) / step], order=1, mode="nearest")


def _outline_distance(p: Array, outline: Array, on_axis: bool) -> Array:
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


def _smoothed(outline: Sequence[Point], corner: float = 40.0, pieces: int = 5) -> Array:
    """Closed outline with a cubic through its points; turns of more than `corner` degrees stay corners."""
    points = as_points(outline)
    chord = np.roll(points, -1, 0) - points
    side = length(chord)[:, None]
    forward, behind = chord / side, np.roll(side, 1, 0)
    backward = np.roll(forward, 1, 0)
    tangent = (side * backward + behind * forward) / (side + behind)  # the shorter side has more say
    tangent *= np.minimum(side, behind)  # so that a long straight side does not bulge at a short neighbour
    sharp = ((forward * backward).sum(-1) < np.cos(np.radians(corner)))[:, None]
    leaving, arriving = np.where(sharp, chord, tangent), np.roll(np.where(sharp, np.roll(chord, 1, 0), tangent), -1, 0)
    t = np.linspace(0, 1, pieces, endpoint=False)[:, None, None]
    cubic = points + (3 * t**2 - 2 * t**3) * chord + (t - 2 * t**2 + t**3) * leaving + (t**3 - t**2) * arriving
    return cubic.transpose(1, 0, 2).reshape(-1, 2)
