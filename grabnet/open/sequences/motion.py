"""How things get from one place to another: smoothly, at rest at both ends (minimum jerk: Flash & Hogan 1985)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation


def minimum_jerk(share: np.ndarray) -> np.ndarray:
    """Share of the time (0 … 1, clipped) → share of the way."""
    s = np.clip(share, 0, 1)
    return s**3 * (10 - 15 * s + 6 * s**2)


@dataclass(frozen=True)
class Pose:
    """A rigid thing's place: rotation (3, 3) and position (3,); or (N, 3, 3) and (N, 3) of them."""

    rotation: np.ndarray
    position: np.ndarray

    def __matmul__(self, inner: Pose) -> Pose:
        """The pose of what is at `inner` in this one's frame."""
        return Pose(self.rotation @ inner.rotation, (self.rotation @ inner.position[..., None])[..., 0] + self.position)

    def inverse(self) -> Pose:
        turned = np.swapaxes(self.rotation, -1, -2)
        return Pose(turned, -(turned @ self.position[..., None])[..., 0])

    def points(self, points: np.ndarray) -> np.ndarray:
        """(P, 3) points of the thing → where they are, (P, 3) or (N, P, 3)."""
        return points @ np.swapaxes(self.rotation, -1, -2) + self.position[..., None, :]


def between(start: np.ndarray, end: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) turned from start to end by shares (N,) of the way: (N, ..., 3, 3)."""
    turn = Rotation.from_matrix(np.swapaxes(start, -1, -2) @ end).as_rotvec()
    part = share.reshape(-1, *[1] * turn.ndim) * turn
    return start @ Rotation.from_rotvec(part.reshape(-1, 3)).as_matrix().reshape(*part.shape, 3)


def travel(start: Pose, end: Pose, n: int, rise: str = "") -> Pose:
    """Poses in `n` frames, the last one at `end`.

    Args:
        rise: "leave" for going up (y) before going aside, as off a table; "land" for the reverse; else all at once.
    """
    time = np.arange(1, n + 1) / n
    late, early = minimum_jerk((time - 0.25) / 0.75), minimum_jerk(time / 0.75)
    up, aside = {"leave": (early, late), "land": (late, early), "": (minimum_jerk(time),) * 2}[rise]
    share = np.stack([aside, up, aside], 1)
    return Pose(between(start.rotation, end.rotation, aside), start.position + share * (end.position - start.position))


def ramp(start: np.ndarray, end: np.ndarray, n: int) -> np.ndarray:
    """Values (K,) → (n, K), the last at `end`."""
    return start + minimum_jerk(np.arange(1, n + 1) / n)[:, None] * (end - start)
