"""Protocol `grasptta` (Jiang et al. 2021; ref. 9): coarse volume, and contact within 5 mm.

Its third number, how far the object moves in simulation, is in `simulated.py`.
"""

from __future__ import annotations

import numpy as np

from grabnet.evaluation.metrics import FIELD, Metric
from grabnet.evaluation.protocol import PerGrasp
from grabnet.evaluation.scene import GraspScene


class GraspTTA(PerGrasp):
    """Intersection volume in voxels of 5 mm, cm³, the wrist closed; contact: 1 where any hand vertex is inside the
    object or within 5 mm of its surface.

    Args:
        spacing: of the voxels, metres.
        reach: of contact, metres.
    """

    name = "grasptta"

    def __init__(self, spacing: float = 0.005, reach: float = 0.005):
        self.spacing = spacing
        self.reach = reach
        self.settings = f"{spacing} {reach}"
        volume = f"centres of {1000 * spacing:g} mm voxels inside both hand and object"
        contact = f"share of grasps with a hand vertex inside or within {1000 * reach:g} mm"
        self.metrics = (
            Metric("grasptta", "volume", "cm³", volume, "lower", section=FIELD, headline=True),
            Metric("grasptta", "contact", "%", contact, "higher", section=FIELD),
        )

    def __call__(self, scene: GraspScene) -> dict[str, np.ndarray]:
        return {
            "volume": 1e6 * scene.shared_volume(self.spacing),
            "contact": (scene.distances.min(1) < self.reach).astype(float),
        }
