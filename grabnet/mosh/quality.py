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
        jump: speed of a marker's place on the body, metres per second, above that at which the marker is seen to move.

    Raises:
        UserError: a value out of range.
    """

    residual: Positive = 0.005
    outlier: Positive = 0.02
    missing: Share = 0.4
    jump: Positive = 6.0

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


def flagged(
    residuals: np.ndarray, model: np.ndarray, observed: np.ndarray, rate: float, limits: Limits
) -> dict[str, np.ndarray]:
    """Numbers of frames to distrust, by reason.

    Args:
        residuals: (T, M) metres; NaN where missing.
        model: (T, M, 3) where the body has the markers.
        observed: (T, M, 3) where they were seen; NaN where missing.
        rate: frames per second.
        limits: beyond which a frame is flagged.
    """
    missing = np.isnan(residuals)
    kept = np.where(residuals > limits.outlier, np.nan, residuals)
    mean = np.nansum(kept, 1) / np.maximum(1, np.isfinite(kept).sum(1))
    step, seen = np.diff(model, axis=0), np.diff(observed, axis=0)
    # A hand that swings a racket is fast, too: only what moves otherwise than its marker, or unseen, has jumped.
    speed = rate * np.fmin(np.linalg.norm(step, axis=-1), np.linalg.norm(step - seen, axis=-1))
    return {
        "markers off": (mean > limits.residual).nonzero()[0],
        "outliers": (residuals > limits.outlier).any(1).nonzero()[0],
        "too few markers": (missing.mean(1) > limits.missing).nonzero()[0],
        "jump": 1 + (speed > limits.jump).any(1).nonzero()[0],
    }


def quality(
    residuals: np.ndarray, model: np.ndarray, observed: np.ndarray, rate: float, layout: Layout, limits: Limits
) -> dict[str, Any]:
    """Facts for the report, JSON-able; lengths in millimetres, shares of all frames; arguments as of `flagged`.

    Residuals are of all markers that are seen, outliers too. They say nothing of what is not seen, and a body that
    bends to every marker has small ones: `missing` and `outliers` stand beside them.
    """
    millimetres = 1e3 * residuals
    missing, outliers = np.isnan(residuals), residuals > limits.outlier
    flags = flagged(residuals, model, observed, rate, limits)
    return {
        "frames": len(residuals),
        "residual_mm": _summary(millimetres),
        "residual_mm_by_type": {
            type_: _summary(millimetres[:, layout.types == type_]) for type_ in dict.fromkeys(layout.types.tolist())
        },
        "residual_mm_by_marker": {
            label: {
                **_summary(millimetres[:, k]),
                "missing": _share(missing[:, k]),
                "outliers": _share(outliers[:, k]),
            }
            for k, label in enumerate(layout.labels)
        },
        "missing": _share(missing),
        "outliers": _share(outliers),
        "flagged_frames": len(np.unique(np.concatenate([*flags.values()]))),
        "flagged": {reason: frames.tolist() for reason, frames in flags.items()},
    }


def _share(true: np.ndarray) -> float:
    return round(float(true.mean()), 4)


def _summary(values: np.ndarray) -> dict[str, float | None]:
    values = values[np.isfinite(values)]
    if not len(values):
        return {"mean": None, "median": None, "p95": None}
    return {
        "mean": round(float(values.mean()), 3),
        "median": round(float(np.median(values)), 3),
        "p95": round(float(np.quantile(values, 0.95)), 3),
    }
