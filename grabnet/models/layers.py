"""The layers that both networks are made of (ref. 6)."""

from __future__ import annotations

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.nn import functional as F

from grabnet.precision import full_precision


class ResidualBlock(nn.Module):
    """`LReLU(skip(x) + BN(W2 LReLU(BN(W1 x))))`, where skip is x, or `LReLU(W3 x)` when the sizes differ.

    Args:
        n_in, n_out, n_hidden: features of input, output and bottleneck.
        slope: of the leaky ReLU for negative input.
    """

    def __init__(self, n_in: int, n_out: int, n_hidden: int = 256, slope: float = 0.2):
        super().__init__()
        self.slope = slope
        self.fc1, self.bn1 = nn.Linear(n_in, n_hidden), BatchNorm(n_hidden)
        self.fc2, self.bn2 = nn.Linear(n_hidden, n_out), BatchNorm(n_out)
        self.fc3 = nn.Linear(n_in, n_out) if n_in != n_out else None

    def forward(self, x: Tensor) -> Tensor:
        skip = x if self.fc3 is None else F.leaky_relu(self.fc3(x), self.slope)
        y = F.leaky_relu(self.bn1(self.fc1(x)), self.slope)
        return F.leaky_relu(skip + self.bn2(self.fc2(y)), self.slope)


class Head(nn.Linear):
    """A layer whose outputs are angles, lengths or a distribution: exact, whatever the layers before it ran in."""

    @full_precision
    def forward(self, x: Tensor) -> Tensor:
        return super().forward(x.to(self.weight.dtype))


class BatchNorm(nn.BatchNorm1d):
    """Normalises features (B, n) by their statistics over the rows of all processes together.

    Where there is one process this is `nn.BatchNorm1d`, under whose names either is saved. Processes may have
    different numbers of rows. (torch's SyncBatchNorm takes no CPU tensors.)
    """

    def forward(self, x: Tensor) -> Tensor:
        if not (self.training and dist.is_available() and dist.is_initialized() and dist.get_world_size() > 1):
            return super().forward(x)
        # Sums about the running mean, which is nearly the batch's: squares of what is left lose no digits.
        shifted = x - self.running_mean
        rows = shifted.new_full((1,), len(x))
        sums = _SumOverProcesses.apply(torch.cat([shifted.sum(0), shifted.square().sum(0), rows]))
        n = sums[-1].detach()
        mean, square = (sums[:-1] / n).chunk(2)
        variance = square - mean.square()
        with torch.no_grad():
            self.num_batches_tracked += 1
            self.running_mean += self.momentum * mean
            self.running_var.lerp_(variance * (n / (n - 1)), self.momentum)
        return ((shifted - mean) * ((variance + self.eps).rsqrt() * self.weight) + self.bias).to(x.dtype)


class _SumOverProcesses(torch.autograd.Function):
    """Sum of the processes' tensors; each one's gradient is the sum of theirs."""

    @staticmethod
    def forward(ctx, x: Tensor) -> Tensor:
        total = x.clone()
        dist.all_reduce(total)
        return total

    @staticmethod
    def backward(ctx, gradient: Tensor) -> Tensor:
        return _SumOverProcesses.apply(gradient.contiguous())


def concatenate(*features: Tensor) -> Tensor:
    """Features side by side, rotation matrices and the like flattened: (B, …) each → (B, sum)."""
    return torch.cat([f.flatten(1) for f in features], 1)
