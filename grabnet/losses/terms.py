"""The terms of the training losses (paper 5.1, spec 7), each a small function; all return a scalar."""

from __future__ import annotations

import warnings

import torch
from torch import Tensor
from torch.distributions import Normal


def kl_to_standard_normal(posterior: Normal) -> Tensor:
    """KL(q ‖ N(0, 1)) summed over latent dimensions, averaged over the batch; closed form."""
    mean, variance = posterior.mean, posterior.variance
    return 0.5 * (mean.square() + variance - variance.log() - 1).sum(-1).mean()


def vertex_l1(vertices: Tensor, true: Tensor, weight: Tensor) -> Tensor:
    """Mean over batch, vertices and coordinates of |Δ| (B, V, 3), weighted per vertex (V,)."""
    return ((vertices - true).abs() * weight.unsqueeze(-1)).mean()


def edge_l1(vertices: Tensor, true: Tensor, differences: Tensor) -> Tensor:
    """Mean |Δ| between the mesh's edge vectors and the true ones; `differences` as `edge_differences` makes it.

    A sparse product: indexing both ends of the edges takes three times as long, its backward most of all.
    """
    by_vertex = (vertices - true).transpose(0, 1).flatten(1)  # (V, B·3)
    return (differences @ by_vertex).abs().mean()


def hand_to_object_l1(distances: Tensor, true: Tensor, weight: Tensor) -> Tensor:
    """Mean |Δ| of hand→object distances (B, V), weighted per vertex (V,)."""
    return ((distances - true).abs() * weight).mean()


def object_to_hand_l1(distances: Tensor, true: Tensor, weights: PointWeights) -> Tensor:
    """Mean |Δ| of object→hand signed distances (B, P), weighted by where they lie."""
    return ((distances - true).abs() * weights(distances.detach(), true)).mean()


class PointWeights:
    """Weights of object points: 1 near the true hand, `far` elsewhere, `penetrating` where the prediction is inside.

    Args:
        near: (lowest, highest) true signed distance that counts as near, metres.
        far, penetrating: weights.
    """

    def __init__(self, near: tuple[float, float] = (-0.005, 0.010), far: float = 0.1, penetrating: float = 1.5):
        self.near, self.far, self.penetrating = tuple(near), far, penetrating

    def __call__(self, distances: Tensor, true: Tensor) -> Tensor:
        weights = torch.full_like(true, self.far)
        weights[(true > self.near[0]) & (true < self.near[1])] = 1.0
        weights[distances < 0] = self.penetrating
        return weights


def edge_differences(faces: Tensor, n_vertices: int) -> Tensor:
    """Sparse (E, V) matrix that takes vertices to edge vectors, each edge of the faces (F, 3) once."""
    edges = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).sort(1).values.unique(dim=0)
    row = torch.arange(len(edges), device=faces.device).repeat(2)
    ends = torch.cat([edges[:, 0], edges[:, 1]])
    sign = torch.ones(2 * len(edges), device=faces.device)
    sign[len(edges) :] = -1
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse")  # torch calls its CSR tensors beta at every first use
        return torch.sparse_coo_tensor(
            torch.stack([row, ends]), sign, (len(edges), n_vertices), check_invariants=False
        ).to_sparse_csr()
