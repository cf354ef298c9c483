"""The bones of a hand or body as segments that follow its vertices: the nearest says which part touches (paper S.7)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grabnet.body.skinned import SkinnedModel

# Singular values below this share of the largest are noise: joints that no vertex follows alone.
_NOISE = 1e-6


@dataclass(frozen=True, eq=False)
class Bones:
    """Bones of a body, each a segment between two points.

    A joint's bones reach to the joints that hang on it. Where none does, its bone reaches to the farthest vertex that
    it moves most, such as a fingertip. Joints that move no vertex have no bones.

    Attributes:
        points: (P, V) float64, what takes the posed vertices to joints and tips.
        ends: (B, 2) int64, the points that each bone joins.
        parts: (B,) uint8 contact label of each bone.
    """

    points: np.ndarray
    ends: np.ndarray
    parts: np.ndarray

    @classmethod
    def of(cls, model: SkinnedModel, rest: np.ndarray, parts: Sequence[int]) -> Bones:
        """Return the bones of a hand or body.

        Args:
            model: whose joints and skinning they follow.
            rest: (V, 3) rest vertices, metres: the subject's.
            parts: contact label of each joint.
        """
        weights = model.weights.cpu().double().numpy()
        rest = np.asarray(rest, np.float64)
        joints = model.J_regressor.cpu().double().numpy() @ rest
        points, ends, labels = _followed(weights, rest, joints), [], []
        moves = weights.any(0)
        for joint in moves.nonzero()[0]:
            below = [child for child, parent in enumerate(model.parents) if parent == joint and moves[child]]
            own = (weights.argmax(1) == joint).nonzero()[0]
            if not below and len(own):
                tip = own[np.linalg.norm(rest[own] - joints[joint], axis=1).argmax()]
                below = [len(points)]
                points = np.concatenate([points, np.eye(1, len(rest), tip)])
            ends += [(joint, point) for point in below or [joint]]
            labels += [parts[joint]] * (len(below) or 1)
        return cls(points, np.array(ends), np.array(labels, np.uint8))

    def segments(self, vertices: np.ndarray) -> np.ndarray:
        """(B, 2, 3) ends of the bones of a body at `vertices` (V or more, 3); what comes after V is ignored."""
        return (self.points @ vertices[: self.points.shape[1]])[self.ends]

    def nearest_parts(self, vertices: np.ndarray, places: np.ndarray) -> np.ndarray:
        """(N,) uint8 labels of the bones nearest to places (N, 3), of a body at `vertices` (V, 3)."""
        start, end = np.moveaxis(self.segments(vertices), 1, 0)
        along = end - start
        offset = np.asarray(places, np.float64)[:, None] - start
        share = (offset * along).sum(-1) / np.maximum((along * along).sum(-1), 1e-20)
        offset -= share.clip(0, 1)[..., None] * along
        return self.parts[(offset * offset).sum(-1).argmin(1)]


def _followed(weights: np.ndarray, rest: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """(J, V) what takes posed vertices to posed joints.

    Skinning is linear in the joints' transforms, so these follow from the vertices by least squares, and from each
    transform the place of its joint. That is exact but for pose correctives.
    """
    n = weights.shape[1]
    homogeneous = np.concatenate([rest, np.ones((len(rest), 1))], 1)
    skinning = (weights[:, :, None] * homogeneous[:, None]).reshape(len(rest), 4 * n)
    transforms = np.linalg.pinv(skinning, rcond=_NOISE).reshape(n, 4, len(rest))
    return np.einsum("ji,jiv->jv", np.concatenate([joints, np.ones((n, 1))], 1), transforms)
