import math

import numpy as np
import pytest
import torch
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from tests.geometry.shapes import CLOSED_FORMS, cup, mesh_of, sphere, torus


def scattered(n: int, seed: int = 0, spread: float = 0.04) -> torch.Tensor:
    return torch.randn(n, 3, generator=torch.Generator().manual_seed(seed)) * spread


@pytest.mark.parametrize("name", CLOSED_FORMS)
def test_signed_distance_agrees_with_the_closed_form(name):
    build, exact = CLOSED_FORMS[name]
    points = scattered(5000)
    # Facets lie up to 12 µm within the curved surfaces they stand for.
    np.testing.assert_allclose(MeshQuery(build()).signed_distance(points), exact(points.numpy()), atol=1.5e-5)


def test_closest_points_agree_with_brute_force():
    mesh = mesh_of(trimesh.creation.icosphere(subdivisions=2, radius=0.04))
    points = scattered(300)
    position, distance, face = MeshQuery(mesh).closest(points)
    by_face = np.stack(
        [
            trimesh.triangles.closest_point(np.repeat(triangle[None], len(points), 0).astype(float), points.numpy())
            for triangle in mesh.triangles
        ]
    )
    all_distances = np.linalg.norm(by_face - points.numpy(), axis=-1)
    np.testing.assert_allclose(distance, all_distances.min(0), atol=1e-7)
    np.testing.assert_allclose(all_distances[face, np.arange(len(points))], all_distances.min(0), atol=1e-7)
    np.testing.assert_allclose((position - points).norm(dim=1), distance, atol=1e-7)


def test_beyond_the_maximum_nothing_is_found():
    query, points = MeshQuery(sphere(0.04)), scattered(2000)
    near = (points.norm(dim=1) - 0.04).abs() < 0.0045
    position, distance, face = query.closest(points, max_distance=0.0045)
    clear = ((points.norm(dim=1) - 0.04).abs() - 0.0045).abs() > 2e-5
    assert torch.equal(distance.isfinite()[clear], near[clear])
    assert torch.equal(distance.isinf(), face == -1)
    assert torch.equal(distance.isinf(), position.isnan().all(1))
    assert torch.equal(query.signed_distance(points, 0.0045).isfinite(), distance.isfinite())
    assert near.any() and not near.all()


def test_an_open_cup_is_closed_by_a_membrane():
    query = MeshQuery(cup(radius=0.04, height=0.1))
    inside = torch.tensor([[0.0, 0, -0.02], [0.02, 0.01, 0.0], [0.039, 0, -0.049]])
    outside = torch.tensor([[0.0, 0, 0.09], [0.05, 0, 0.0], [0, 0, -0.06]])
    assert (query.signed_distance(inside) < 0).all()
    assert (query.signed_distance(outside) > 0).all()
    np.testing.assert_allclose(query.signed_distance(inside)[:1], [-0.03], atol=1e-6)  # to the floor, not the membrane


def test_overlapping_parts_have_one_inside():
    """Where two solids overlap rays cross an even number of faces."""
    parts = [trimesh.creation.box((0.06, 0.06, 0.06)), trimesh.creation.box((0.1, 0.03, 0.03))]
    both = trimesh.util.concatenate(parts)
    points = scattered(3000, spread=0.02)
    inside = np.stack([(np.abs(points.numpy()) < part.extents / 2).all(1) for part in parts]).any(0)
    np.testing.assert_array_equal(MeshQuery(mesh_of(both)).signed_distance(points) < 0, inside)


def test_rays_decide_on_long_thin_faces():
    """As of CAD exports: of a finely tessellated tube the winding number takes .6 ms a point."""
    tube = mesh_of(trimesh.creation.annulus(0.035, 0.038, 0.1, sections=4000))
    query, points = MeshQuery(tube), scattered(20_000)
    assert tube.is_closed and not query.overlaps
    distance = query.signed_distance(points)
    radius = points[:, :2].norm(dim=1)
    within = (radius > 0.03501) & (radius < 0.03799) & (points[:, 2].abs() < 0.05)
    assert (distance[within] < 0).all()
    assert (distance[(radius < 0.0349) | (radius > 0.0381)] > 0).all()


def test_a_mesh_inside_out_has_the_same_inside():
    mesh, points = torus(), scattered(2000)
    turned = Mesh(mesh.vertices, mesh.faces[:, ::-1])
    torch.testing.assert_close(MeshQuery(turned).signed_distance(points), MeshQuery(mesh).signed_distance(points))


def test_degenerate_faces_do_no_harm():
    mesh, points = sphere(), scattered(500)
    a, b, _ = mesh.faces[0]
    spoiled = Mesh(mesh.vertices, np.concatenate([mesh.faces, [[a, a, b], [b, b, b]]]))
    torch.testing.assert_close(MeshQuery(spoiled).signed_distance(points), MeshQuery(mesh).signed_distance(points))


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**31))
def test_distance_does_not_depend_on_the_frame(seed):
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    matrix[:3, 3] = rng.normal(size=3) * 0.1
    mesh, points = torus(), scattered(200, seed)
    moved = torch.tensor(points.double().numpy() @ matrix[:3, :3].T + matrix[:3, 3]).float()
    found = MeshQuery(mesh.transformed(matrix)).signed_distance(moved)
    torch.testing.assert_close(found, MeshQuery(mesh).signed_distance(points), atol=3e-7, rtol=0)


def test_threads_and_odd_inputs_change_nothing():
    query, points = MeshQuery(torus()), scattered(50_000).double()
    threads = torch.get_num_threads()
    try:
        results = []
        for n in (1, 3):
            torch.set_num_threads(n)
            results.append(query.signed_distance(points.requires_grad_()))
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(*results)
    assert results[0].dtype == torch.float32
    assert query.signed_distance(torch.zeros(0, 3)).shape == (0,)
    assert query.closest(torch.full((1, 3), math.nan)).face.tolist() == [-1]
