"""Signed distances of the primitives against brute force over dense samples of their surfaces, and their joins."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from grabnet.open.objects.basic import pyramid
from grabnet.open.objects.primitives import (
    box,
    capsule,
    cylinder,
    ellipsoid,
    extruded,
    lathe,
    loft,
    sphere,
    sweep,
    torus,
)
from grabnet.open.objects.solid import FILLET, Solid, blend, pruned

POINTS = np.random.default_rng(0).uniform(-0.04, 0.04, (3000, 3))
TURN = np.linspace(0, 2 * np.pi, 96, endpoint=False)
HEXAGON = [(0.02 * np.cos(a), 0.02 * np.sin(a)) for a in TURN[::16]]


def circle(radius: float, z: float) -> np.ndarray:
    return np.stack([radius * np.cos(TURN), radius * np.sin(TURN), np.full(len(TURN), z)], -1)


def brute_force(convex: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Nearest of many surface samples; inside when behind every face."""
    samples, _ = trimesh.sample.sample_surface(convex, 300_000, seed=0)
    off = cKDTree(samples).query(points)[0]
    heights = points @ convex.face_normals.T - (convex.triangles_center * convex.face_normals).sum(-1)
    return np.where(heights.max(1) < 0, -off, off)


@pytest.mark.parametrize(
    ("solid", "corners"),
    [
        (box(0.03, 0.05, 0.02, rounding=0), trimesh.creation.box((0.03, 0.05, 0.02)).vertices),
        (cylinder(0.02, 0.03, rounding=0), np.concatenate([circle(0.02, -0.015), circle(0.02, 0.015)])),
        (
            pyramid(0.04, 0.03, rounding=0).solid,
            [(x, y, 0) for x in (-0.02, 0.02) for y in (-0.02, 0.02)] + [(0, 0, 0.03)],
        ),
        (extruded(HEXAGON, 0.03, rounding=0), [(x, y, z) for x, y in HEXAGON for z in (-0.015, 0.015)]),
        (
            lathe([(0, -0.01), (0.02, -0.01), (0.01, 0.02), (0, 0.02)]),
            np.concatenate([circle(0.02, -0.01), circle(0.01, 0.02)]),
        ),
    ],
    ids=["box", "cylinder", "pyramid", "extruded", "lathe"],
)
def test_distance_matches_brute_force(solid: Solid, corners):
    points = POINTS[(np.maximum(solid.low - POINTS, POINTS - solid.high) < 0.01).all(1)]
    assert len(points) > 200
    found, true = solid.distance(points), brute_force(trimesh.convex.convex_hull(corners), points)
    assert (found < true + 0.0005).all()
    near = np.abs(true) < 0.0015  # further off, a lower bound will do
    np.testing.assert_allclose(found[near], true[near], atol=0.0005)


def test_tube_matches_samples_of_its_curve():
    arc = np.linspace(0, np.pi, 9)
    tube = sweep([(0.02 * np.cos(a), 0.02 * np.sin(a), 0) for a in arc], 0.005)
    fine = np.linspace(0, np.pi, 20001)
    curve = np.stack([0.02 * np.cos(fine), 0.02 * np.sin(fine), 0 * fine], -1)
    near = POINTS[cKDTree(curve).query(POINTS)[0] < 0.02]
    np.testing.assert_allclose(tube.distance(near), cKDTree(curve).query(near)[0] - 0.005, atol=0.0002)


def test_round_cone_ends_in_its_balls():
    cone = capsule((0, 0, 0), (0, 0, 0.02), 0.01, 0.005)
    np.testing.assert_allclose(
        cone.distance(np.array([[0, 0, -0.01], [0, 0, 0.025], [0.0075, 0, 0.01]])), 0, atol=1e-12
    )


def test_ellipsoid_and_loft_are_zero_on_the_surface_and_right_in_sign():
    directions = POINTS / np.linalg.norm(POINTS, axis=-1, keepdims=True)
    on = directions * (0.03, 0.02, 0.01)
    np.testing.assert_allclose(ellipsoid(0.03, 0.02, 0.01).distance(on), 0, atol=1e-12)
    assert (ellipsoid(0.03, 0.02, 0.01).distance(1.1 * on) > 0).all()
    assert (ellipsoid(0.03, 0.02, 0.01).distance(0.9 * on) < 0).all()

    tapered = loft([(-0.03, 0.01, 0.006), (0.0, 0.02, 0.01), (0.03, 0.015, 0.008)])
    angle = np.linspace(0, 2 * np.pi, 50)
    ring = np.stack([0 * angle, 0.02 * np.cos(angle), 0.01 * np.sin(angle)], -1)
    np.testing.assert_allclose(tapered.distance(ring), 0, atol=1e-5)


def test_smooth_outline_passes_its_points_and_keeps_sharp_corners():
    outline = [(0, 0), (0.02, 0), (0.024, 0.01), (0.023, 0.02), (0, 0.02)]
    bulged = lathe(outline, smooth=True)
    given_points = np.array([(r, 0, z) for r, z in outline[1:4]])
    np.testing.assert_allclose(bulged.distance(given_points), 0, atol=0.0003)
    straight = np.array([(0.022, 0, 0.005)])  # middle of a side that leans out: the curve lies further out
    assert bulged.distance(straight)[0] < -0.0001


coordinate = st.floats(-0.03, 0.03)


@given(st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=1, max_size=20))
@settings(deadline=None, max_examples=50)
def test_joins_stay_within_a_fillet_of_the_sharp_ones(points):
    p = np.array(points)
    a, b = sphere(0.012), box(0.02, 0.02, 0.02).at(0.01)
    da, db = a.distance(p), b.distance(p)
    for joined, sharp in (((a | b), np.minimum(da, db)), ((a - b), np.maximum(da, -db)), ((a & b), np.maximum(da, db))):
        assert (np.abs(joined.distance(p) - sharp) <= FILLET / 4 + 1e-12).all()
    wide = blend(a, b, radius=0.01).distance(p)
    assert (wide <= np.minimum(da, db) + 1e-12).all()
    assert (wide >= np.minimum(da, db) - 0.0025 - 1e-12).all()


@given(st.tuples(coordinate, coordinate, coordinate), st.floats(-180, 180))
@settings(deadline=None, max_examples=50)
def test_moves_are_rigid(point, degrees):
    p = np.array([point])
    solid = box(0.03, 0.01, 0.02).at(0.01, 0.005, 0.0)
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    forward = p @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]).T
    np.testing.assert_allclose(solid.turned("z", degrees).distance(forward), solid.distance(p), atol=1e-12)
    np.testing.assert_allclose(solid.at(z=0.01).distance(p + np.array([0, 0, 0.01])), solid.distance(p), atol=1e-12)
    mirrored = solid.mirrored("y")
    np.testing.assert_allclose(mirrored.distance(p), mirrored.distance(p * (1, -1, 1)), atol=1e-12)


def test_bounds_hold_the_solid_after_moves():
    for solid in (
        torus(0.02, 0.005).turned("x", 40).at(0.01),
        capsule((0, 0, 0), (0.02, 0.01, 0), 0.008).stretched(y=1.5),
    ):
        inside = POINTS[solid.distance(POINTS) < 0]
        assert len(inside) > 20
        assert (inside >= solid.low - 1e-9).all()
        assert (inside <= solid.high + 1e-9).all()


def test_pruning_never_overestimates_and_is_exact_nearby():
    plain = sphere(0.005)
    far = 3 * POINTS
    bounded, exact = pruned(plain).distance(far), plain.distance(far)
    assert (bounded <= exact + 1e-12).all()
    near = exact < 0.01
    np.testing.assert_array_equal(bounded[near], exact[near])
