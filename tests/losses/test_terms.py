"""Loss terms against plain loops and torch's own distributions."""

import torch
from torch.distributions import Normal, kl_divergence

from grabnet.losses.terms import (
    PointWeights,
    edge_differences,
    edge_l1,
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


def test_edges_of_a_tetrahedron():
    differences = edge_differences(torch.tensor([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]), 4).double()
    edges = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    a, b = random(2, 4, 3), random(2, 4, 3, seed=1)
    expected = torch.stack([(a[:, i] - a[:, j]) - (b[:, i] - b[:, j]) for i, j in edges]).abs().mean()
    torch.testing.assert_close(edge_l1(a, b, differences), expected)
    torch.testing.assert_close(edge_l1(a, a + 1, differences), torch.zeros((), dtype=torch.float64))  # moves are free


def test_edge_gradient_is_that_of_differences():
    differences = edge_differences(torch.tensor([[0, 1, 2], [0, 2, 3]]), 4).double()
    a = random(2, 4, 3).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: edge_l1(x, random(2, 4, 3, seed=1), differences), a)


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
