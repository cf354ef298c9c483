"""Rigid alignment of corresponding points, and the motion of objects by their markers (paper 3.2)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import torch
from torch import Tensor

from grabnet.mosh.so3 import exp, log

# Below this ratio of second to first singular value the points lie on a line, and the turn about it is free.
_COLLINEAR = 1e-3
_TRIPLES = 60  # of markers, tried where some are outliers


def align(source: Tensor, target: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Rotation and translation that move `source` onto `target` in the sense of weighted least squares (Kabsch).

    Args:
        source, target: (..., N, 3) points; of any value, NaN too, where the weight is 0.
        weights: (..., N) trust in each point, at least 0.

    Returns:
        rotation (..., 3, 3) and translation (..., 3), so that `target ≈ source @ rotation.mT + translation`; NaN where
        fewer than three points count, or all lie on a line.
    """
    enough = (weights > 0).sum(-1) >= 3
    w = (weights / weights.sum(-1, keepdim=True).clamp_min(1e-30)).unsqueeze(-1)
    source, target = torch.where(w > 0, source, 0), torch.where(w > 0, target, 0)
    source_mean, target_mean = (w * source).sum(-2, keepdim=True), (w * target).sum(-2, keepdim=True)
    covariance = (w * (target - target_mean)).mT @ (source - source_mean)
    u, s, vt = torch.linalg.svd(covariance)
    enough = enough & (s[..., 1] >= _COLLINEAR * s[..., 0]) & (s[..., 0] > 0)
    # A reflection can fit better than any rotation when points are coplanar: flip the least certain axis back.
    flip = torch.ones_like(s)
    flip[..., 2] = torch.linalg.det(u @ vt).sign()
    rotation = (u * flip.unsqueeze(-2)) @ vt
    translation = target_mean.squeeze(-2) - (rotation @ source_mean.mT).squeeze(-1)
    return (
        torch.where(enough[..., None, None], rotation, torch.nan),
        torch.where(enough.unsqueeze(-1), translation, torch.nan),
    )


class DegenerateMarkersError(ValueError):
    """No frame shows three markers that are not on one line."""


@dataclass(frozen=True)
class RigidMotion:
    """Where an object is.

    Attributes:
        rotations: (T, 3, 3) from the object's own frame to the world's, for column vectors.
        transl: (T, 3) metres.
        solved: (T,) whether the frame shows enough markers. The others are interpolated, or held at the ends.
        filled: (T,) whether it is in a gap short enough to be interpolated; what is neither is not known.
        residuals: (T, M) distances of the markers, metres; NaN where missing or not solved.
    """

    rotations: Tensor
    transl: Tensor
    solved: Tensor
    filled: Tensor
    residuals: Tensor


def follow(
    positions: Tensor,
    observed: Tensor,
    tolerance: float = 0.004,
    max_gap: int = 12,
    weights: Tensor | None = None,
    smooth: int = 0,
) -> RigidMotion:
    """Follow an object by its markers.

    A frame is aligned in closed form. Where a marker is off by more than the tolerance, the frame is aligned to the
    three markers with which most others agree, and then to all that agree.

    Args:
        positions: (M, 3) markers in the object's own frame, metres.
        observed: (T, M, 3) where they were seen; NaN where missing.
        tolerance: metres beyond which a marker is an outlier.
        max_gap: frames of a gap that is interpolated.
        weights: (M,) trust in each marker; equal when omitted.
        smooth: frames to either side that a parabola is fitted through, to average noise out; 0 to leave it.

    Raises:
        DegenerateMarkersError: no frame can be solved.
    """
    positions, observed = positions.double(), observed.double()
    seen = observed[..., 0].isfinite()
    trust = seen.double() * (1.0 if weights is None else weights.double())
    rotation, transl = align(positions.expand_as(observed), observed, trust)
    off = _distances(positions, observed, rotation, transl)
    doubtful = ((off > tolerance) & seen).any(1).nonzero().squeeze(1)
    if len(doubtful):
        agreeing = _agreeing(positions, observed[doubtful], trust[doubtful], tolerance)
        rotation[doubtful], transl[doubtful] = align(
            positions.expand(len(doubtful), -1, -1), observed[doubtful], trust[doubtful] * agreeing
        )
    solved = transl.isfinite().all(1)
    if not solved.any():
        raise DegenerateMarkersError(
            "no frame shows 3 of its markers that agree with its model and are not on one line"
        )
    off = _distances(positions, observed, rotation, transl)
    rotation, transl, gap = _bridged(rotation, transl, solved)
    if smooth:
        rotation, transl = _smoothed(rotation, transl, positions.mean(0), smooth, solved | (gap <= max_gap))
        off = torch.where(solved.unsqueeze(1), _distances(positions, observed, rotation, transl), torch.nan)
    return RigidMotion(rotation, transl, solved, ~solved & (gap <= max_gap), off)


def _distances(positions: Tensor, observed: Tensor, rotation: Tensor, transl: Tensor) -> Tensor:
    return (positions @ rotation.mT + transl.unsqueeze(1) - observed).norm(dim=-1)


def _agreeing(positions: Tensor, observed: Tensor, trust: Tensor, tolerance: float) -> Tensor:
    """(T, M) 1 for the largest set of markers that fits a pose, of those that three markers give; at least three."""
    triples = [*combinations(range(len(positions)), 3)]
    triples = triples[:: max(1, len(triples) // _TRIPLES)]
    best, count = torch.zeros_like(trust), torch.full((len(trust),), 2)
    for triple in triples:
        among = torch.zeros_like(trust)
        among[:, triple] = trust[:, triple]
        rotation, transl = align(positions.expand_as(observed), observed, among)
        near = (_distances(positions, observed, rotation, transl) < tolerance).double() * (trust > 0)
        more = near.sum(1) > count
        best[more], count[more] = near[more], near.sum(1)[more].long()
    return best


def _bridged(rotation: Tensor, transl: Tensor, solved: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Frames that are not solved filled from those around; and the length of the gap that each frame is in."""
    t = torch.arange(len(solved))
    at = t[solved]
    after = torch.searchsorted(at, t).clamp(max=len(at) - 1)
    before = torch.where(at[after] > t, after - 1, after).clamp(min=0)
    a, b = at[before], at[after]
    share = ((t - a) / (b - a).clamp(min=1)).clamp(0, 1).to(transl.dtype)
    turn = log(rotation[a].mT @ rotation[b]) * share.unsqueeze(1)
    outside = (t < at[0]) | (t > at[-1])
    gap = torch.where(outside, torch.iinfo(t.dtype).max, b - a - 1)
    return rotation[a] @ exp(turn), transl[a] + share.unsqueeze(1) * (transl[b] - transl[a]), gap


def _smoothed(rotation: Tensor, transl: Tensor, middle: Tensor, reach: int, known: Tensor) -> tuple[Tensor, Tensor]:
    """The value at each frame of the parabolas that fit turn, and place of the middle, best in the frames around.

    Towards the ends, and towards frames of which nothing is known, fewer frames are taken, as many before as after.
    """
    t, last = torch.arange(len(transl)), len(transl) - 1
    borders = torch.cat([torch.tensor([-1, last + 1]), t[~known]]).sort().values
    after = torch.searchsorted(borders, t).clamp(min=1)
    reaches = torch.minimum(t - borders[after - 1], borders[after] - t).sub(1).clamp(0, reach)
    weights = torch.zeros(reach + 1, 2 * reach + 1, dtype=transl.dtype)  # by a frame's reach and the offset from it
    for r in range(reach + 1):
        powers = torch.stack([torch.arange(-r, r + 1).double() ** k for k in range(3)], 1)
        weights[r, reach - r : reach + r + 1] = torch.linalg.pinv(powers)[0]  # of the values in the parabola's at 0
    place = transl + rotation @ middle
    turn, shift = torch.zeros_like(transl), torch.zeros_like(transl)
    for column, offset in enumerate(range(-reach, reach + 1)):
        other, weight = (t + offset).clamp(0, last), weights[reaches, column].unsqueeze(1)
        turn += weight * log(rotation.mT @ rotation[other])
        shift += weight * (place[other] - place)
    rotation = rotation @ exp(turn)
    return rotation, place + shift - rotation @ middle


def model_of(observed: Tensor) -> Tensor:
    """(M, 3) markers of an object without a model, as they lie in the frame that shows most, centred; for `follow`.

    Args:
        observed: (T, M, 3) where they were seen, metres; NaN where missing.

    Raises:
        DegenerateMarkersError: no frame shows all of them.
    """
    seen = observed[..., 0].isfinite().all(1)
    if not seen.any():
        raise DegenerateMarkersError("no frame shows all of its markers at once")
    observed = observed[seen].double()
    model = observed[0] - observed[0].mean(0)
    for _ in range(3):  # the mean of all frames, laid over each other
        rotation, transl = align(observed, model.expand_as(observed), torch.ones(observed.shape[:2]).double())
        laid = observed @ rotation.mT + transl.unsqueeze(1)
        model = laid.nanmedian(0).values
        model = model - model.mean(0)
    return model
