"""Cubes, cylinders, spheres, pyramids and toruses, three sizes each."""

from __future__ import annotations

from functools import partial

import numpy as np

from grabnet.open.objects.primitives import box, cylinder, sphere, torus
from grabnet.open.objects.prop import Prop
from grabnet.open.objects.solid import Array, Solid


def cube(side: float) -> Prop:
    return Prop(box(side, side, side).resting())


def rod(radius: float, height: float) -> Prop:
    return Prop(cylinder(radius, height).resting())


def ball(radius: float) -> Prop:
    return Prop(sphere(radius).resting())


def pyramid(side: float, height: float, rounding: float = 0.002) -> Prop:
    """Square base of length `side` at the bottom, the apex above its middle."""
    slope = np.hypot(height, side / 2)
    outward = np.array([height, side / 2]) / slope  # of a side face: (horizontal, vertical)
    inset = height * side / 2 / slope - rounding

    def distance(p: Array) -> Array:
        reach = np.abs(p[:, :2]).max(-1)
        walls = np.stack([reach * outward[0] + p[:, 2] * outward[1] - inset, rounding - p[:, 2]])
        both = np.linalg.norm(np.maximum(walls, 0), axis=0)
        return both + np.minimum(walls.max(0), 0) - rounding

    half = side / 2
    return Prop(Solid(distance, np.array([-half, -half, 0]), np.array([half, half, height])))


def ring(outer: float, tube: float) -> Prop:
    return Prop(torus(outer - tube, tube).resting())


PROPS = {
    "cubesmall": partial(cube, 0.040),
    "cubemedium": partial(cube, 0.060),
    "cubelarge": partial(cube, 0.080),
    "cylindersmall": partial(rod, 0.018, 0.060),
    "cylindermedium": partial(rod, 0.027, 0.090),
    "cylinderlarge": partial(rod, 0.036, 0.120),
    "spheresmall": partial(ball, 0.020),
    "spheremedium": partial(ball, 0.030),
    "spherelarge": partial(ball, 0.040),
    "pyramidsmall": partial(pyramid, 0.045, 0.045),
    "pyramidmedium": partial(pyramid, 0.065, 0.065),
    "pyramidlarge": partial(pyramid, 0.085, 0.085),
    "torussmall": partial(ring, 0.030, 0.008),
    "torusmedium": partial(ring, 0.045, 0.012),
    "toruslarge": partial(ring, 0.060, 0.016),
}
