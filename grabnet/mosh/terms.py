"""What a solved frame should fulfil: residual terms, each with its unit and weight, as parts of normal equations.

A weight is the inverse of a standard deviation, so that the sum of all terms is a negative logarithm of likelihood and
its parts compare. Every term gives its exact gradient; `Normal` gathers JᵀJ and Jᵀr, frame by frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from grabnet.mosh.attachment import Attachment, Placed, Pose
from grabnet.mosh.priors import HandPrior, JointPrior
from grabnet.mosh.so3 import log, log_change


@dataclass
class Normal:
    """Normal equations of F frames: hessian (F, n, n), gradient (F, n), cost (F)."""

    hessian: Tensor
    gradient: Tensor
    cost: Tensor


@dataclass(frozen=True)
class MarkerTerm:
    """Distances of the markers to where they were seen; those far beyond `reach` lose their say (Geman-McClure).

    Attributes:
        observed: (F, M, 3) metres; NaN where missing.
        sigma: (M,) standard deviation of each marker, metres.
        reach: standard deviations at which a marker's pull is largest, about; infinite for plain least squares.
    """

    observed: Tensor
    sigma: Tensor
    reach: float

    def residuals(self, placed: Placed) -> Tensor:
        """(F, M, 3) in standard deviations; 0 where missing."""
        return ((placed.points - self.observed) / self.sigma.unsqueeze(-1)).nan_to_num(0.0)

    def cost(self, placed: Placed) -> Tensor:
        """(F,)"""
        square = self.residuals(placed).square().sum(-1)
        return (square * self._kept(square).sqrt()).sum(-1) / 2

    def add_to(self, normal: Normal, placed: Placed, jacobian: Tensor) -> None:
        """Add this term, given the attachment's (F, n, 3M) Jacobian."""
        residuals = self.residuals(placed)
        square = residuals.square().sum(-1)
        kept = self._kept(square)
        normal.cost += (square * kept.sqrt()).sum(-1) / 2
        seen = self.observed[..., 0].isfinite()
        root = torch.where(seen, kept.sqrt() / self.sigma, 0).repeat_interleave(3, -1)
        weighted = jacobian * root.unsqueeze(1)
        normal.hessian += weighted @ weighted.mT
        pull = residuals * kept.sqrt().unsqueeze(-1)
        normal.gradient += (weighted @ pull.flatten(1).unsqueeze(-1)).squeeze(-1)

    def _kept(self, square: Tensor) -> Tensor:
        """Weight of each marker's residual, 1 for small ones."""
        if self.reach == float("inf"):
            return torch.ones_like(square)
        return (self.reach**2 / (self.reach**2 + square)) ** 2


class PosePrior:
    """Turns of joints against what is usual for them, and shape coefficients against 0; both in standard deviations.

    Args:
        attachment: whose joints are solved for.
        prior: of all joints.
        shape_sigma: (S,) standard deviations of the shape coefficients.
    """

    def __init__(self, attachment: Attachment, prior: JointPrior, shape_sigma: Tensor):
        self._joints, self._dtype = attachment.joints, attachment.dtype
        to = {"device": attachment.device, "dtype": self._dtype}
        self.mean, self.precision = (value.to(**to)[self._joints] for value in (prior.mean, prior.precision))
        self._hands = [hand for one in prior.hands if (hand := _HandTerm.of(one, self._joints, to))]
        self._shape_weight = shape_sigma.to(**to) ** -2

    def cost(self, pose: Pose, factor: Tensor) -> Tensor:
        """(F,); factor (F,) multiplies each frame's prior."""
        off = log(pose.rotations[:, self._joints]) - self.mean
        joints = torch.einsum("fja,jab,fjb->f", off, self.precision, off)
        for hand in self._hands:
            joints = joints + hand.square(off + self.mean)
        return factor * (joints + (self._shape_weight * pose.shape.square()).sum(-1)) / 2

    def add_to(self, normal: Normal, pose: Pose, factor: Tensor) -> None:
        """Add this term; factor (F,) multiplies each frame's prior."""
        turn = log(pose.rotations[:, self._joints])
        change = log_change(turn)
        off = turn - self.mean
        pulled = change.mT @ self.precision  # (F, J, 3, 3)
        pull = (pulled @ off.unsqueeze(-1)).squeeze(-1)
        normal.cost += factor * ((off * (self.precision @ off.unsqueeze(-1)).squeeze(-1)).sum((1, 2))) / 2
        end = 3 + 3 * len(self._joints)
        normal.gradient[:, 3:end] += factor.unsqueeze(1) * pull.flatten(1)
        blocks = normal.hessian[:, 3:end, 3:end].unflatten(1, (-1, 3)).unflatten(3, (-1, 3))
        blocks.diagonal(dim1=1, dim2=3).add_((factor[:, None, None, None] * (pulled @ change)).permute(0, 2, 3, 1))
        for hand in self._hands:
            hand.add_to(normal, turn, change, factor)
        if pose.shape.shape[1]:
            weight = factor.unsqueeze(1) * self._shape_weight
            normal.cost += (weight * pose.shape.square()).sum(-1) / 2
            normal.gradient[:, end:] += weight * pose.shape
            normal.hessian[:, end:, end:].diagonal(dim1=1, dim2=2).add_(weight)


class _HandTerm(NamedTuple):
    """The prior of a hand's joints together: places (k,) of these among those solved for, mean (3k,), precision
    (3k, 3k)."""

    places: Tensor
    mean: Tensor
    precision: Tensor

    @classmethod
    def of(cls, prior: HandPrior, joints: Tensor, to: dict[str, Any]) -> _HandTerm | None:
        """The part of a prior that is about joints solved for; None where none is."""
        own = torch.isin(prior.joints, joints.cpu())
        if not own.any():
            return None
        kept = own.repeat_interleave(3)
        precision = torch.linalg.inv(prior.covariance[kept][:, kept])
        places = torch.searchsorted(joints, prior.joints[own].to(joints.device))
        return cls(places, prior.mean[kept].to(**to), precision.to(**to))

    def square(self, turn: Tensor) -> Tensor:
        """(F,) squared distance of rotation vectors (F, J, 3) from the mean, in standard deviations."""
        off = turn[:, self.places].flatten(1) - self.mean
        return ((off @ self.precision) * off).sum(1)

    def add_to(self, normal: Normal, turn: Tensor, change: Tensor, factor: Tensor) -> None:
        """Add the term at rotation vectors (F, J, 3), which change by (F, J, 3, 3) with a step."""
        pull = ((turn[:, self.places].flatten(1) - self.mean) @ self.precision).unflatten(1, (-1, 3))
        change = change[:, self.places]
        rows = (3 + 3 * self.places.unsqueeze(1) + torch.arange(3, device=self.places.device)).flatten()
        normal.cost += factor * self.square(turn) / 2
        normal.gradient[:, rows] += factor.unsqueeze(1) * (change.mT @ pull.unsqueeze(-1)).flatten(1)
        k = len(self.places)
        blocks = torch.einsum("fkba,kblc,flcd->fkald", change, self.precision.view(k, 3, k, 3), change)
        normal.hessian[:, rows.unsqueeze(1), rows] += factor[:, None, None] * blocks.reshape(-1, 3 * k, 3 * k)


class Velocity:
    """Change from one frame to the next against an expected one, in standard deviations.

    The residual of a joint is log(Rᵀ·R′) - v for its rotations R, R′ in neighbouring frames and the expected change v.
    For v = 0 its gradient is exactly ±weight·residual; its Hessian is taken with unit Jacobians, right to second order.

    Args:
        weight: (n,) inverse variances of the change of each unknown per frame.
        joints: those solved for.
    """

    def __init__(self, weight: Tensor, joints: Tensor):
        self.weight, self._joints = weight, joints

    def steps(self, before: Pose, after: Pose) -> Tensor:
        """(F, n) changes between poses F by F."""
        turn = log(before.rotations[:, self._joints].mT @ after.rotations[:, self._joints])
        return torch.cat([after.transl - before.transl, turn.flatten(1), after.shape - before.shape], 1)

    def cost(self, steps: Tensor) -> Tensor:
        """(F,) of changes (F, n), less the expected ones."""
        return (self.weight * steps.square()).sum(-1) / 2
