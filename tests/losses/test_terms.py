"""Loss terms against plain loops and torch's own distributions."""

import torch
from torch.distributions import Normal, kl_divergence

from grabnet.losses.edges import EdgeL1
from grabnet.losses.terms import (
    PointWeights,
    hand_to_object_l1,
    kl_to_standard_normal,
    object_to_hand_l1,
    vertex_l1,
)


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_kl_is_torchs():
    posterior = Normal(random(7, 16), random(7, 16, seed=1).exp())
    expected = kl_divergence(posterior, Normal(0.0, 1.0)).sum(1).mean()
    torch.testing.assert_close(kl_to_standard_normal(posterior), expected)


def test_vertices_weigh_by_vertex():
    a, b, weight = random(2, 4, 3), random(2, 4, 3, seed=1), torch.tensor([0.0, 1.0, 0.5, 0.0], dtype=torch.float64)
    total = sum(weight[v] * abs(a[n, v, c] - b[n, v, c]) for n in range(2) for v in range(4) for c in range(3))
    torch.testing.assert_close(vertex_l1(a, b, weight), total / 24)


TETRAHEDRON = torch.tensor([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])


def test_edges_of_a_tetrahedron():
    edges = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    a, b = random(2, 4, 3).requires_grad_(), random(2, 4, 3, seed=1)
    loss = EdgeL1(TETRAHEDRON, 4)
    expected = torch.stack([(a[:, i] - a[:, j]) - (b[:, i] - b[:, j]) for i, j in edges]).abs().mean()
    torch.testing.assert_close(loss(a, b), expected, rtol=1e-5, atol=0)
    torch.testing.assert_close(
        loss(a, a + 1), torch.zeros((), dtype=torch.float64), rtol=0, atol=1e-6
    )  # moves are free


def test_edge_gradient_is_that_of_plain_torch(hand):
    """Of a whole mesh with a rim, among several, where launches take several threads."""
    faces = hand.faces
    edges = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).sort(1).values.unique(dim=0)
    a, b = (random(60, 778, 3, seed=k).float().requires_grad_() for k in (0, 1))
    difference = a - b
    expected = (difference[:, edges[:, 0]] - difference[:, edges[:, 1]]).abs().mean()
    loss = EdgeL1(faces, 778)(a, b)
    torch.testing.assert_close(loss, expected)
    for found, true in zip(*(torch.autograd.grad(3 * value, (a, b)) for value in (loss, expected)), strict=True):
        torch.testing.assert_close(found, true)


def test_distances_weigh_by_vertex():
    a, b, weight = random(3, 5), random(3, 5, seed=1), random(5, seed=2).abs()
    torch.testing.assert_close(hand_to_object_l1(a, b, weight), sum(((a - b).abs() * weight).flatten()) / 15)


def test_points_weigh_by_where_they_lie():
    true = torch.tensor([[-0.006, -0.004, 0.009, 0.02, 0.02]])
    predicted = torch.tensor([[0.001, 0.001, 0.001, 0.001, -0.001]])
    weights = PointWeights(near=(-0.005, 0.010), far=0.1, penetrating=1.5)
    torch.testing.assert_close(weights(predicted, true), torch.tensor([[0.1, 1.0, 1.0, 0.1, 1.5]]))
    expected = ((predicted - true).abs() * torch.tensor([[0.1, 1.0, 1.0, 0.1, 1.5]])).mean()
    torch.testing.assert_close(object_to_hand_l1(predicted, true, weights), expected)
