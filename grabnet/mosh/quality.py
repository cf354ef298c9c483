"""How good a solved recording is: distances left between markers and body, and frames to distrust."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from grabnet.cli.checks import Positive, Share, in_range
from grabnet.mosh.attachment import Attachment, Pose
from grabnet.mosh.layouts import Layout

_BATCH = 512


@dataclass(frozen=True)
class Limits:
    """Beyond which a frame is flagged.

    Attributes:
        residual: mean distance of its markers, metres.
        outlier: distance of a marker that is taken for a ghost or wrongly labelled, metres.
        missing: share of markers that are missing.
        jump: metres that a marker of the model moves from one frame to the next.

    Raises:
        UserError: a value out of range.
    """

    residual: Positive = 0.005
    outlier: Positive = 0.02
    missing: Share = 0.4
    jump: Positive = 0.05

    def __post_init__(self):
        in_range(self, "limits.")


@torch.no_grad()
def marker_residuals(attachment: Attachment, pose: Pose, observed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T, M) distances of markers to where the model has them, metres, NaN where missing; (T, M, 3) the model's."""
    places = [
        attachment.place(pose.frames(slice(start, start + _BATCH))).points.double().numpy()
        for start in range(0, len(observed), _BATCH)
    ]
    model = np.concatenate(places)
    return np.linalg.norm(model - observed, axis=-1), model


def flagged(residuals: np.ndarray, model: np.ndarray, limits: Limits) -> dict[str, np.ndarray]:
    """Numbers of frames to distrust, by reason."""
    missing = np.isnan(residuals)
    kept = np.where(residuals > limits.outlier, np.nan, residuals)
    mean = np.nansum(kept, 1) / np.maximum(1, np.isfinite(kept).sum(1))
    moved = np.linalg.norm(np.diff(model, axis=0), axis=-1).max(1, initial=0) if len(model) > 1 else np.zeros(0)
    return {
        "markers off": (mean > limits.residual).nonzero()[0],
        "outliers": (residuals > limits.outlier).any(1).nonzero()[0],
        "too few markers": (missing.mean(1) > limits.missing).nonzero()[0],
        "jump": 1 + (moved > limits.jump).nonzero()[0],
    }


def quality(residuals: np.ndarray, model: np.ndarray, layout: Layout, limits: Limits) -> dict[str, Any]:
    """Facts for the report, JSON-able; lengths in millimetres."""
    millimetres = 1e3 * residuals
    return {
        "frames": len(residuals),
        "residual_mm": _summary(millimetres),
        "residual_mm_by_type": {
            type_: _summary(millimetres[:, layout.types == type_]) for type_ in dict.fromkeys(layout.types.tolist())
        },
        "residual_mm_by_marker": {
            label: _summary(millimetres[:, k]) for k, label in enumerate(layout.labels)
        },
        "missing": round(float(np.isnan(residuals).mean()), 4),
        "flagged": {reason: frames.tolist() for reason, frames in flagged(residuals, model, limits).items()},
    }  # fmt: skip


def _summary(values: np.ndarray) -> dict[str, float | None]:
    values = values[np.isfinite(values)]
    if not len(values):
        return {"mean": None, "median": None, "p95": None}
    return {
        "mean": round(float(values.mean()), 3),
        "median": round(float(np.median(values)), 3),
        "p95": round(float(np.quantile(values, 0.95)), 3),
    }
