"""The residual block that both networks are made of (spec 6)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F


class ResidualBlock(nn.Module):
    """`LReLU(skip(x) + BN(W2 LReLU(BN(W1 x))))`, where skip is x, or `LReLU(W3 x)` when the sizes differ.

    Args:
        n_in, n_out, n_hidden: features of input, output and bottleneck.
        slope: of the leaky ReLU for negative input.
    """

    def __init__(self, n_in: int, n_out: int, n_hidden: int = 256, slope: float = 0.2):
        super().__init__()
        self.slope = slope
        self.fc1, self.bn1 = nn.Linear(n_in, n_hidden), nn.BatchNorm1d(n_hidden)
        self.fc2, self.bn2 = nn.Linear(n_hidden, n_out), nn.BatchNorm1d(n_out)
        self.fc3 = nn.Linear(n_in, n_out) if n_in != n_out else None

    def forward(self, x: Tensor) -> Tensor:
        skip = x if self.fc3 is None else F.leaky_relu(self.fc3(x), self.slope)
        y = F.leaky_relu(self.bn1(self.fc1(x)), self.slope)
        return F.leaky_relu(skip + self.bn2(self.fc2(y)), self.slope)


def concatenate(*features: Tensor) -> Tensor:
    """Features side by side, rotation matrices and the like flattened: (B, …) each → (B, sum)."""
    return torch.cat([f.flatten(1) for f in features], 1)
