"""The terms of the training losses (paper 4, ref. 7), each a small function; all return a scalar."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.distributions import Normal

from grabnet.cli.checks import Weight
from grabnet.errors import UserError


def kl_to_standard_normal(posterior: Normal) -> Tensor:
    """KL(q ‖ N(0, 1)) summed over latent dimensions, averaged over the batch; closed form."""
    mean, variance = posterior.mean, posterior.variance
    return 0.5 * (mean.square() + variance - variance.log() - 1).sum(-1).mean()


def vertex_l1(vertices: Tensor, true: Tensor, weight: Tensor) -> Tensor:
    """Mean over batch, vertices and coordinates of |Δ| (B, V, 3), weighted per vertex (V,)."""
    return ((vertices - true).abs().mean(0) * weight.unsqueeze(-1)).mean()


def hand_to_object_l1(distances: Tensor, true: Tensor, weight: Tensor) -> Tensor:
    """Mean |Δ| of hand→object distances (B, V), weighted per vertex (V,)."""
    return ((distances - true).abs().mean(0) * weight).mean()


def object_to_hand_l1(distances: Tensor, true: Tensor, weights: PointWeights) -> Tensor:
    """Mean |Δ| of object→hand signed distances (B, P), weighted by where they lie."""
    return ((distances - true).abs() * weights(distances.detach(), true)).mean()


class PointWeights:
    """Weights of object points: 1 near the true hand, `far` elsewhere, `penetrating` where the prediction is inside.

    Args:
        near: (lowest, highest) true signed distance that counts as near, metres.
        far, penetrating: weights.
    """

    def __init__(self, near: tuple[float, float] = (-0.005, 0.010), far: Weight = 0.1, penetrating: Weight = 1.5):
        if not near[0] < near[1]:
            raise UserError(f"near is {list(near)}; its first distance must be below its second.")
        self.near, self.far, self.penetrating = tuple(near), far, penetrating

    def __call__(self, distances: Tensor, true: Tensor) -> Tensor:
        near = (true > self.near[0]) & (true < self.near[1])
        return torch.where(distances < 0, self.penetrating, torch.where(near, 1.0, self.far)).to(true.dtype)
