"""How objects are shown to a network: centres and points by hand, refusals in one sentence."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from grabnet.errors import UserError
from grabnet.geometry.conventions import Conventions
from grabnet.geometry.mesh import Mesh

PUBLISHED = Conventions("box", "samples", "samples")
REMEDY = "do otherwise"


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    """A box with most of its vertices at one end, off its own origin."""
    solid = trimesh.creation.box((0.05, 0.06, 0.1)).subdivide().subdivide()
    solid.vertices[:, 2] = 0.1 * (solid.vertices[:, 2] / 0.1 + 0.5) ** 2 - 0.05
    return Mesh(solid.vertices + np.array([0.3, -0.2, 0.1]), solid.faces)


def test_the_centre_is_the_mean_vertex_or_the_middle_of_the_box(mesh):
    np.testing.assert_allclose(Conventions("box").centre_of(mesh), [0.3, -0.2, 0.1], atol=1e-7)
    np.testing.assert_allclose(Conventions().centre_of(mesh), mesh.vertices.astype(float).mean(0), atol=1e-7)
    assert np.linalg.norm(Conventions().centre_of(mesh) - Conventions("box").centre_of(mesh)) > 0.002


def test_in_use_the_centre_does_not_depend_on_where_the_vertices_crowd(mesh):
    """About the mean vertex of a mesh of even faces, however uneven the one given is."""
    even = trimesh.creation.box((0.05, 0.06, 0.1))
    for _ in range(4):
        even = even.subdivide()
    even = Mesh(even.vertices + np.array([0.3, -0.2, 0.1]), even.faces)
    known = Conventions().in_use
    assert known.centre == "surface" and PUBLISHED.in_use == PUBLISHED
    np.testing.assert_allclose(known.centre_of(mesh), Conventions().centre_of(even), atol=1e-6)
    np.testing.assert_allclose(known.centre_of(even), Conventions().centre_of(even), atol=1e-6)


def test_subdividing_keeps_the_surface_and_halves_every_side(mesh):
    fine = mesh.subdivided()
    assert len(fine.faces) == 4 * len(mesh.faces)
    np.testing.assert_array_equal(fine.vertices[: len(mesh.vertices)], mesh.vertices)
    assert fine.volume == pytest.approx(mesh.volume) and fine.volume > 0
    areas = [trimesh.triangles.area(m.triangles.astype(float)) for m in (mesh, fine)]
    np.testing.assert_allclose(areas[1].reshape(-1, 4), np.repeat(areas[0][:, None] / 4, 4, 1), rtol=1e-3)
    expected = {tuple(v.round(6)) for v in mesh.trimesh().subdivide().vertices}
    assert {tuple(v.round(6)) for v in fine.vertices.astype(float)} == expected


def test_points_in_use_are_different_vertices_of_the_subdivided_mesh(mesh):
    known = replace(PUBLISHED, points_in_use=500)
    fine = mesh.trimesh()
    while len(fine.vertices) < 500:
        fine = fine.subdivide()
    assert len(fine.vertices) > 500
    assert_chosen(known.vertices_in_use(mesh), fine.vertices, 500)
    np.testing.assert_array_equal(known.vertices_in_use(mesh), known.vertices_in_use(mesh))
    # Not subdivided where there are enough.
    assert_chosen(replace(known, points_in_use=10).vertices_in_use(mesh), mesh.vertices, 10)


def assert_chosen(points, vertices, n):
    """n different ones of the vertices, about the middle of the box."""
    distance, number = cKDTree(vertices - np.array([0.3, -0.2, 0.1])).query(points.numpy())
    assert distance.max() < 1e-6 and len(set(number)) == len(points) == n


@pytest.mark.parametrize(
    ("change", "aspects", "said"),
    [
        ({"centre": "mean_vertex"}, ("centre",), "data.centre=box, and would be .* data.centre=mean_vertex: do o"),
        ({"distance_to": "surface"}, ("distances",), "data.distance_to=samples .*objects with data.distance_to=surf"),
        ({"object_points": 512}, ("distances",), "object_points=2048 .*object_points=512"),
        ({"points_in_use": 512}, ("basis",), "basis_to=samples data.points_in_use=10000, and .*points_in_use=512"),
    ],
)
def test_a_network_that_would_see_something_else_is_refused(change, aspects, said):
    with pytest.raises(UserError, match=f"a network was trained with .*{said}"):
        PUBLISHED.check_shown("a network", replace(PUBLISHED, **change), aspects, REMEDY)


def test_what_it_does_not_see_does_not_matter():
    PUBLISHED.check_shown("a network", replace(PUBLISHED, basis_to="surface"), ("centre", "distances"), REMEDY)
    PUBLISHED.check_shown("a network", replace(PUBLISHED, rotate=False, hand="x"), ("centre", "basis"), REMEDY)
    # How many points there are is all one where none of them counts.
    Conventions().check_shown("a network", Conventions(object_points=5), ("centre", "distances", "basis"), REMEDY)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"centre": "top"}, "data.centre is 'top'; it can be mean_vertex, surface, box"),
        ({"basis_to": "points"}, "data.basis_to is 'points'; it can be surface, samples"),
        ({"points_in_use": 0}, "data.points_in_use is 0; it must be at least 1"),
    ],
)
def test_unknown_words_and_numbers_are_refused(values, said):
    with pytest.raises(UserError, match=said):
        Conventions(**values)
