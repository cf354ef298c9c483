"""Plausible grasp poses, for the mean pose and the principal components of the model file."""

from __future__ import annotations

import numpy as np
import torch

from grabnet.body.anatomy import Anatomy
from grabnet.geometry.rotations import matrix_to_axis_angle

# Fraction of closing → radians, at a fully closed hand.
_CLOSED = {"mcp_flexion": 1.3, "pip": 1.5, "dip": 0.9, "cmc_flexion": 0.5, "mcp": 0.6, "ip": 0.9}
_RELAXED = {"mcp_flexion": 0.35, "pip": 0.5, "dip": 0.3, "mcp": 0.2, "ip": 0.25}
_SPREAD = {"mcp_abduction": 0.08, "cmc_flexion": 0.2, "cmc_abduction": 0.25, "cmc_twist": 0.2}


def grasp_poses(anatomy: Anatomy, n: int, seed: int) -> np.ndarray:
    """(n, 45) axis-angle poses: the fingers close together by a common share, each with some will of its own."""
    rng = np.random.default_rng(seed)
    closing = rng.beta(1.3, 1.5, n)
    angles = np.zeros((n, len(anatomy.angle_names)))
    own = {}
    for k, name in enumerate(anatomy.angle_names):
        finger, _, joint = name.partition("_")
        if finger not in own:
            own[finger] = closing + rng.normal(0, 0.18, n)
        share = np.clip(own[finger] + rng.normal(0, 0.12, n), -0.1, 1)
        angles[:, k] = _CLOSED.get(joint, 0) * share + rng.normal(0, _SPREAD.get(joint, 0.08), n)
    limits = anatomy.angle_limits.numpy()
    return to_axis_angle(anatomy, np.clip(angles, *limits.T))


def relaxed_pose(anatomy: Anatomy) -> np.ndarray:
    """(45,) a hand at rest, in axis-angle."""
    angles = [_RELAXED.get(name.partition("_")[2], 0) for name in anatomy.angle_names]
    return to_axis_angle(anatomy, np.array(angles))


def principal_poses(poses: np.ndarray) -> np.ndarray:
    """(n, 45) → (45, 45) orthonormal rows, the most telling first."""
    return np.linalg.svd(np.cov(poses.T))[2]


def to_axis_angle(anatomy: Anatomy, angles: np.ndarray) -> np.ndarray:
    matrices = anatomy.hand_pose(torch.as_tensor(angles, dtype=anatomy.angle_axes.dtype))
    return matrix_to_axis_angle(matrices).flatten(-2).numpy()
