"""Protocol `halo` (Karunratanakul et al. 2021; ref. 9): volume, depth and contact of closed hands with the object."""

from __future__ import annotations

from typing import Self

import numpy as np

from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.metrics import FIELD, Metric
from grabnet.evaluation.protocol import PerGrasp
from grabnet.evaluation.scene import GraspScene


class Halo(PerGrasp):
    """Intersection volume in voxels of 1 mm, deepest vertex, and whether any vertex is inside.

    The wrist is closed first. volume: voxels whose centres are inside both, cm³. depth: of the deepest hand vertex
    inside the object, cm, 0 where none is. contact: 1 where any hand vertex is inside the object, so that its signed
    distance is below 0; over grasps, the contact ratio.

    Args:
        samples: grasps per object (20 in the protocol).
        spacing: of the voxels, metres.
    """

    name = "halo"

    def __init__(self, samples: int = 20, spacing: float = 0.001):
        self.spacing = spacing
        self.settings = f"{spacing}"
        volume = f"centres of {1000 * spacing:g} mm voxels inside both hand and object"
        depth = "depth of the deepest hand vertex inside the object"
        contact = "share of grasps with a hand vertex inside the object"
        self.metrics = (
            Metric("halo", "volume", "cm³", volume, "lower", samples, FIELD, headline=True, distribution=True),
            Metric("halo", "depth", "cm", depth, "lower", samples, FIELD, headline=True),
            Metric("halo", "contact", "%", contact, "higher", samples, FIELD, headline=True),
        )

    @classmethod
    def of(cls, inputs: EvaluationInputs) -> Self:
        return cls(inputs.config.halo_samples)

    def __call__(self, scene: GraspScene) -> dict[str, np.ndarray]:
        nearest = scene.distances.min(1)
        return {
            "volume": 1e6 * scene.shared_volume(self.spacing),
            "depth": 100 * np.maximum(-nearest, 0),
            "contact": (nearest < 0).astype(float),
        }
