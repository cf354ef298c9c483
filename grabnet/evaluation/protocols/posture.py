"""Protocol `posture`: whether a hand could have that posture: overlap with itself, and joints beyond their limits."""

from __future__ import annotations

from typing import Self

import numpy as np
import torch

from grabnet.evaluation.hands import HandLabels
from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.metrics import HAND, Metric
from grabnet.evaluation.protocol import PerGrasp
from grabnet.evaluation.scene import GraspScene
from grabnet.grasping.joints import beyond_limits

# Degrees beyond a limit that do not count: poses are kept in half precision in places.
_TOLERANCE = 1.0


class Posture(PerGrasp):
    """Overlap of the hand with itself, and joint limits.

    self_volume: of 1 mm voxels about which the hand's closed surface winds twice or more, cm³; small folds inside bent
    joints count, and are in every hand that skinning makes. violations: how many of the 21 anatomical angles are
    beyond their limits (`ANGLE_LIMITS`) by more than 1°. excess: the largest angle beyond its limit, degrees.
    off_axis: the largest angle by which a joint turns about an axis that it does not have, degrees. The last three
    need joint rotations and are missing for hands that are known as meshes only.

    Args:
        labels: of the hand model.
        spacing: of the voxels, metres.
    """

    name = "posture"

    def __init__(self, labels: HandLabels, spacing: float = 0.001):
        self.labels = labels
        self.spacing = spacing
        self.settings = f"{spacing}"
        numbers = {
            ("self_volume", "cm³"): f"{1000 * spacing:g} mm voxels that the hand encloses twice",
            ("violations", "of 21"): f"anatomical angles more than {_TOLERANCE:g}° beyond their limits",
            ("excess", "°"): "largest angle beyond its limit",
            ("off_axis", "°"): "largest turn about an axis that the joint does not have",
        }
        self.metrics = tuple(
            Metric("posture", name, unit, about, "lower", section=HAND, of_hand_alone=True)
            for (name, unit), about in numbers.items()
        )

    @classmethod
    def of(cls, inputs: EvaluationInputs) -> Self:
        return cls(inputs.labels)

    def __call__(self, scene: GraspScene) -> dict[str, np.ndarray]:
        twice = [c.inside(at_least=2).n_voxels for c in scene.crossings(self.spacing)]
        results = {metric.name: np.full(len(scene.hands), np.nan) for metric in self.metrics}
        results["self_volume"] = 1e6 * self.spacing**3 * np.array(twice, float)
        if scene.hands.hand_pose is not None:
            results |= joint_limits(self.labels, scene.hands.hand_pose)
        return results


def joint_limits(labels: HandLabels, hand_pose: np.ndarray) -> dict[str, np.ndarray]:
    """Return violations, excess and off_axis (N,) of joint rotations (N, 15, 3, 3); see `Posture`."""
    beyond, off_axis = beyond_limits(labels.anatomy, torch.as_tensor(hand_pose))
    return {
        "violations": (beyond > _TOLERANCE).sum(1).double().numpy(),
        "excess": beyond.amax(1).double().numpy(),
        "off_axis": off_axis.amax(1).double().numpy(),
    }
