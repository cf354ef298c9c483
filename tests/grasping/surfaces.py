"""Objects whose distances are formulas, in any precision."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor


def surface(formula: Callable[[Tensor], Tensor]) -> Callable[[Tensor], tuple[Tensor, Tensor]]:
    """A surface as the optimiser takes it: distances differentiable in the points, normals constant."""

    def look(points: Tensor) -> tuple[Tensor, Tensor]:
        with torch.enable_grad():
            leaf = points.detach().requires_grad_()
            (normal,) = torch.autograd.grad(formula(leaf).sum(), leaf)
        return formula(points), normal

    return look


def ball(radius: float, centre: Tensor):
    return surface(lambda p: (p - centre.to(p)).square().sum(-1).add(1e-12).sqrt() - radius)
