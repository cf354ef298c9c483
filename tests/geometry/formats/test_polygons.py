"""Polygons cut into triangles: area, shape and sides as they were."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from grabnet.geometry.formats.geometry import FormatError, gathered, triangulated
from grabnet.geometry.formats.obj import read


def star(n: int, seed: int) -> np.ndarray:
    """(n, 3) a polygon seen whole from its middle, mostly not convex, in a plane anyhow."""
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, n) * 0.02 + np.arange(n) * 2 * np.pi / n)
    flat = rng.uniform(0.3, 1, n)[:, None] * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    return flat @ trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3].T + rng.normal(size=3)


def area_vectors(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(points[faces], 1, 0)
    return np.cross(b - a, c - a) / 2


@settings(deadline=None, max_examples=60)
@given(n=st.integers(4, 12), seed=st.integers(0, 2**31))
def test_no_triangle_lies_outside_its_polygon(n, seed):
    """Triangles whose normals agree and whose areas add up to the polygon's cover it once."""
    points = star(n, seed)
    faces = triangulated(points, np.array([n]), np.arange(n)).faces
    assert len(faces) == n - 2
    vectors = area_vectors(points, faces)
    whole = np.cross(points - points.mean(0), np.roll(points, -1, 0) - points.mean(0)).sum(0) / 2
    np.testing.assert_allclose(vectors.sum(0), whole, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1).sum(), np.linalg.norm(whole), rtol=1e-6)


@settings(deadline=None, max_examples=60)
@given(n=st.integers(4, 9), seed=st.integers(0, 2**31), shift=st.integers(0, 8))
def test_a_reversed_polygon_has_the_same_triangles_reversed(n, seed, shift):
    """Wherever it starts, and with vertices of its own."""
    points, back = star(n, seed), np.roll(np.arange(n)[::-1], shift)
    both = np.concatenate([points, points])
    faces = triangulated(both, np.array([n, n]), np.concatenate([np.arange(n), n + back])).faces
    one, other = faces[: n - 2], faces[n - 2 :] % n
    assert sorted(map(tuple, np.sort(one, 1))) == sorted(map(tuple, np.sort(other, 1)))
    np.testing.assert_allclose(area_vectors(points, one).sum(0), -area_vectors(points, other).sum(0), atol=1e-9)


def test_triangles_stay_as_they_are_and_polygons_in_order():
    faces = triangulated(np.eye(3)[[0, 1, 2, 0, 1]], *gathered([[2, 0, 1], [0, 1], [1, 2, 0, 3], [4, 3, 2]])).faces
    assert faces[0].tolist() == [2, 0, 1] and faces[-1].tolist() == [4, 3, 2] and len(faces) == 4


def test_a_solid_of_concave_polygons_has_its_volume():
    """An L of height 1 and area 3, as an OBJ of hexagons and quads."""
    corners = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    lines = [f"v {x} {y} {z}" for z in (0, 1) for x, y in corners]
    lines += ["f 6 5 4 3 2 1", "f 7 8 9 10 11 12"]
    lines += [f"f {i + 1} {(i + 1) % 6 + 1} {(i + 1) % 6 + 7} {i + 7}" for i in range(6)]
    solid = trimesh.Trimesh(*read("\n".join(lines).encode()), process=False)
    assert solid.is_watertight and solid.volume == pytest.approx(3) and solid.area == pytest.approx(14)


def test_faces_that_would_take_hours_to_cut_are_refused():
    points = star(3000, 0)
    with pytest.raises(FormatError, match=r"1 hollow faces of 3,000 corners: export it as triangles"):
        triangulated(points, np.array([3000]), np.arange(3000))
    assert len(triangulated(points[::10], np.array([300]), np.arange(300)).faces) == 298


@pytest.mark.parametrize("corners", [[0, 1, 3], [-1, 0, 1], [0, 1, 2**40]])
def test_corners_at_no_vertex_are_refused(corners):
    with pytest.raises(FormatError, match="a face names vertex"):
        triangulated(np.eye(3), np.array([3]), np.array(corners))
