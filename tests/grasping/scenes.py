"""Objects whose distances are formulas."""

from __future__ import annotations

import torch
from torch import Tensor

from grabnet.grasping.proposing.grasped_object import Part


class ClosedForm:
    """A scene whose distances are a formula, in any precision and differentiable to any order."""

    floor = -1.0

    def __init__(self, formula):
        self.formula = formula
        anywhere = torch.ones(3)
        zero = torch.zeros(3)
        self.parts = [Part(-anywhere, anywhere, 1.0, zero[None], zero[None], anywhere / 3**0.5, False, zero)]

    def distance(self, points: Tensor) -> Tensor:
        return self.formula(points)

    def distance_and_normal(self, points: Tensor) -> tuple[Tensor, Tensor]:
        with torch.enable_grad():
            points = points if points.requires_grad else points.detach().requires_grad_()
            distance = self.formula(points)
            (normal,) = torch.autograd.grad(distance.sum(), points, create_graph=True)
        return distance, normal


def ball(radius: float, centre: tuple[float, float, float] = (0, 0, 0)) -> ClosedForm:
    return ClosedForm(lambda p: (p - p.new_tensor(centre)).norm(dim=-1) - radius)
