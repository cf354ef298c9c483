"""Nearest vertices against a KD-tree, the side of the surface against vertex normals and a sphere's closed form."""

import pytest
import torch
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from grabnet.body.anatomy import vertex_normals
from grabnet.body.hand import HandParameters
from grabnet.geometry.nearest import NearestVertex, by_neighbourhood, nearest_point_distance
from grabnet.geometry.rotations import axis_angle_to_matrix


@pytest.fixture(scope="module")
def poses(hand) -> torch.Tensor:
    """Hands bent so far that vertices of distant parts come together."""
    turns = axis_angle_to_matrix(torch.randn(3, 16, 3, generator=torch.Generator().manual_seed(0)))
    return hand(HandParameters.from_rotations(turns, torch.zeros(3, 3))).vertices


@pytest.mark.parametrize("spread", [0.002, 0.03, 1.0])
def test_agrees_with_a_tree_and_with_vertex_normals(hand, poses, spread):
    nearest = NearestVertex(hand.faces, hand.v_template)
    generator = torch.Generator().manual_seed(1)
    chosen = torch.randint(poses.shape[1], (3, 500), generator=generator)
    near = poses.gather(1, chosen.unsqueeze(-1).expand(-1, -1, 3))
    queries = near + spread * torch.randn(3, 500, 3, generator=generator)
    index, distance = nearest(queries, poses)
    normals = vertex_normals(poses, hand.faces)
    for k in range(3):
        expected, _ = cKDTree(poses[k].numpy()).query(queries[k].numpy())
        offset = queries[k] - poses[k][index[k]]
        for found in (offset.norm(dim=-1), distance[k].abs()):
            torch.testing.assert_close(found.double(), torch.from_numpy(expected), atol=2e-6, rtol=1e-5)
        along = (offset * normals[k][index[k]]).sum(-1)
        clear = along.abs() > 1e-6
        assert torch.equal((distance[k] < 0)[clear], (along < 0)[clear])


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**31), n=st.integers(4, 200), q=st.integers(0, 40))
def test_any_number_of_vertices_and_queries(seed, n, q):
    generator = torch.Generator().manual_seed(seed)
    points = torch.randn(2, n, 3, generator=generator)
    faces = torch.randint(n, (2 * n, 3), generator=generator)
    queries = torch.randn(2, q, 3, generator=generator)
    index, _ = NearestVertex(faces, points[0])(queries, points)
    distance = nearest_point_distance(queries, points)
    for k in range(2):
        expected, _ = cKDTree(points[k].numpy()).query(queries[k].numpy())
        for found in ((queries[k] - points[k][index[k]]).norm(dim=-1), distance[k]):
            torch.testing.assert_close(found.double(), torch.as_tensor(expected).double(), atol=1e-6, rtol=1e-5)


def test_sign_and_size_on_a_sphere():
    ball = trimesh.creation.icosphere(4, 1.0)
    points = torch.tensor(ball.vertices).unsqueeze(0)
    nearest = NearestVertex(torch.tensor(ball.faces), torch.tensor(ball.vertices))
    queries = torch.randn(1, 200, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    offset = nearest.signed_offset(queries, points)
    true = queries.norm(dim=-1) - 1
    far = true.abs() > 0.1  # nearer, the spacing of the vertices shows
    assert torch.equal(offset.sign()[far], true.sign()[far])
    assert (offset - true)[far].abs().max() < 0.02


def test_gradient_is_that_of_the_distance_to_the_nearest_vertex(hand, poses):
    """Against autograd through the gathered vertices; and finite at a vertex itself."""
    nearest = NearestVertex(hand.faces, hand.v_template)
    generator = torch.Generator().manual_seed(1)
    queries = 0.1 * torch.randn(3, 77, 3, generator=generator)
    weights = torch.randn(3, 77, generator=generator)
    found, expected = poses.clone().requires_grad_(), poses.clone().requires_grad_()
    (nearest.signed_offset(queries, found) * weights).sum().backward()
    index, distance = nearest(queries, poses)
    reached = expected.gather(1, index.long().unsqueeze(-1).expand(-1, -1, 3))
    ((queries - reached).norm(dim=-1) * distance.sign() * weights).sum().backward()
    torch.testing.assert_close(found.grad, expected.grad, atol=1e-5, rtol=1e-4)
    found.grad = None
    nearest.signed_offset(poses, found).sum().backward()
    assert found.grad.isfinite().all()


def test_neighbours_follow_each_other():
    """Each point once; and each sixteen fill a small part of the whole."""
    points = torch.rand(500, 3, generator=torch.Generator().manual_seed(0))
    order = by_neighbourhood(points, 16)
    assert torch.equal(order.sort().values, torch.arange(500))
    groups = points[order[:496]].view(31, 16, 3)
    assert (groups.amax(1) - groups.amin(1)).prod(-1).max() < 1 / 8
