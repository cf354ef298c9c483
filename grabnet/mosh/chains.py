"""Chains of frames whose normal equations are coupled from one frame to the next: block-tridiagonal, solved directly.

The cost grows in proportion to the number of frames: each frame takes one Cholesky factor and one inverse of its block.
Several chains are solved side by side, as a batch.
"""

from __future__ import annotations

import torch
from torch import Tensor


def solve_chains(hessian: Tensor, gradient: Tensor, coupling: Tensor) -> Tensor:
    """Newton steps of chains whose blocks off the diagonal are -diag(coupling).

    Args:
        hessian: (C, L, n, n) diagonal blocks, float64, symmetric; overwritten.
        gradient: (C, L, n).
        coupling: (n,) at least 0, or (C, L - 1, n) one for each pair of neighbours.

    Returns:
        (C, L, n) steps x with H·x = -gradient.
    """
    c, length, n = gradient.shape
    coupling = coupling.expand(c, length - 1, n) if length > 1 else coupling
    right = -gradient
    inverse = hessian
    for t in range(length):
        if t:
            between = coupling[:, t - 1]
            hessian[:, t] -= between.unsqueeze(-1) * inverse[:, t - 1] * between.unsqueeze(-2)
            right[:, t] += between * (inverse[:, t - 1] @ right[:, t - 1].unsqueeze(-1)).squeeze(-1)
        factor, _ = torch.linalg.cholesky_ex(hessian[:, t])
        inverse[:, t] = torch.cholesky_inverse(factor)
    steps = torch.empty_like(right)
    for t in reversed(range(length)):
        pulled = right[:, t] if t == length - 1 else right[:, t] + coupling[:, t] * steps[:, t + 1]
        steps[:, t] = (inverse[:, t] @ pulled.unsqueeze(-1)).squeeze(-1)
    return steps


def solve_chains_densely(hessian: Tensor, gradient: Tensor, coupling: Tensor) -> Tensor:
    """As `solve_chains`, by one matrix for each whole chain: slow, plain, and what the fast way is tested against."""
    c, length, n = gradient.shape
    coupling = coupling.expand(c, max(length - 1, 0), n)
    steps = []
    for k in range(c):
        whole = torch.block_diag(*hessian[k])
        for t in range(length - 1):
            here, there = slice(t * n, (t + 1) * n), slice((t + 1) * n, (t + 2) * n)
            whole[here, there] = whole[there, here] = -torch.diag(coupling[k, t])
        steps.append(torch.linalg.solve(whole, -gradient[k].flatten()).view(length, n))
    return torch.stack(steps)
