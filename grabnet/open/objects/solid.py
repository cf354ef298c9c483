"""Solids as signed distances: what the open objects are made of.

A `Solid` is a function from points to signed distance (negative inside, metres) and a box that holds it. Solids join
(`a | b`), cut (`a - b`) and intersect (`a & b`) with edges rounded by `FILLET`, so that every shape has the slightly
soft edges of a printed prop; `blend` joins with a wider fillet. Distances are exact for most primitives, first-order
for the elliptic ones, and stay close after joining (Quilez, "Distance functions").
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

FILLET = 0.002  # metres; joins and cuts are rounded over about this width
REACH = 0.02  # metres; wider than any blend


@dataclass(frozen=True)
class Solid:
    """`distance` maps (N, 3) points to (N,) metres; `low`, `high` (3,) bound the solid."""

    distance: Callable[[Array], Array]
    low: Array
    high: Array

    def __or__(self, other: Solid) -> Solid:
        return union(self, other)

    def __sub__(self, other: Solid) -> Solid:
        return self.cut(other)

    def __and__(self, other: Solid) -> Solid:
        return Solid(
            lambda p: _smooth_max(self.distance(p), other.distance(p), FILLET),
            np.maximum(self.low, other.low),
            np.minimum(self.high, other.high),
        )

    def cut(self, other: Solid, radius: float = FILLET) -> Solid:
        """Self without other, the edges rounded over `radius`."""
        return Solid(lambda p: _smooth_max(self.distance(p), -other.distance(p), radius), self.low, self.high)

    def at(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Solid:
        """Moved by (x, y, z)."""
        offset = np.array([x, y, z])
        return Solid(lambda p: self.distance(p - offset), self.low + offset, self.high + offset)

    def turned(self, axis: str, degrees: float) -> Solid:
        """Turned about the axis "x", "y" or "z" through the origin, right-handed."""
        i = "xyz".index(axis)
        j, k = (i + 1) % 3, (i + 2) % 3
        cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        rotation = np.eye(3)
        rotation[[j, j, k, k], [j, k, j, k]] = cos, -sin, sin, cos
        corners = np.stack(np.meshgrid(*zip(self.low, self.high, strict=True), indexing="ij"), -1).reshape(-1, 3)
        corners = corners @ rotation.T
        return Solid(lambda p: self.distance(p @ rotation), corners.min(0), corners.max(0))

    def mirrored(self, axis: str) -> Solid:
        """Self and its mirror image across the plane through the origin, joined."""
        i = "xyz".index(axis)
        sign = np.ones(3)
        sign[i] = -1
        image = Solid(lambda p: self.distance(p * sign), *np.sort([self.low * sign, self.high * sign], 0))
        return self | image

    def grown(self, margin: float) -> Solid:
        """Offset outwards by `margin` metres (inwards when negative)."""
        return Solid(lambda p: self.distance(p) - margin, self.low - margin, self.high + margin)

    def stretched(self, x: float = 1.0, y: float = 1.0, z: float = 1.0) -> Solid:
        """Scaled along the axes about the origin; the distance then errs by up to the ratio of the factors."""
        factor = np.array([x, y, z])
        return Solid(lambda p: self.distance(p / factor) * factor.min(), self.low * factor, self.high * factor)

    def resting(self) -> Solid:
        """Moved so that the bounding box stands on z = 0."""
        return self.at(z=-self.low[2])


def blend(*solids: Solid, radius: float) -> Solid:
    """Union whose concave seams are filled over about `radius` metres (which may bulge by radius / 4 at most)."""
    return Solid(
        lambda p: reduce(lambda a, b: _smooth_min(a, b, radius), (s.distance(p) for s in solids)),
        np.min([s.low for s in solids], 0),
        np.max([s.high for s in solids], 0),
    )


def union(*solids: Solid) -> Solid:
    """All of them joined, like a | b | …"""
    return blend(*solids, radius=FILLET)


def _smooth_min(a: Array, b: Array, radius: float) -> Array:
    """Quadratic smooth minimum: equals the minimum where the two differ by more than `radius`."""
    return np.minimum(a, b) - np.maximum(radius - np.abs(a - b), 0) ** 2 / (4 * radius)


def _smooth_max(a: Array, b: Array, radius: float) -> Array:
    return -_smooth_min(-a, -b, radius)


def pruned(solid: Solid) -> Solid:
    """The same solid, evaluated only within `REACH` of its box; beyond, the distance to the box stands in for it.

    That is a lower bound of the true distance, so nothing near any surface changes, while costly parts of a large
    object are asked only about their surroundings.
    """

    def distance(p: Array) -> Array:
        value = length(np.maximum(np.maximum(solid.low - p, p - solid.high), 0))
        near = value < REACH
        value[near] = solid.distance(p[near])
        return value

    return Solid(distance, solid.low, solid.high)


def length(vectors: Array) -> Array:
    """(N, D) to (N,); for short rows several times faster than `np.linalg.norm`."""
    return np.sqrt(np.einsum("nd,nd->n", vectors, vectors))


def as_points(points: ArrayLike) -> Array:
    return np.asarray(points, dtype=np.float64)
