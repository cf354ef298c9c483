"""Protocol `grasptta` (Jiang et al. 2021; ref. 9): coarse volume, and contact within 5 mm.

Its third number, how far the object moves in simulation, is `physics`'s.
"""

from __future__ import annotations

import numpy as np

from grabnet.evaluation.metrics import Metric
from grabnet.evaluation.scene import Scene


class GraspTTA:
    """Intersection volume in voxels of 5 mm, cm³, the wrist closed; contact: 1 where any hand vertex is inside the
    object or within 5 mm of its surface.

    Args:
        spacing: of the voxels; reach: of contact; metres.
    """

    name = "grasptta"
    metrics = (
        Metric("grasptta", "volume", "cm³", "centres of 5 mm voxels inside both hand and object", "lower"),
        Metric("grasptta", "contact", "%", "share of grasps with a hand vertex inside or within 5 mm", "higher"),
    )

    def __init__(self, spacing: float = 0.005, reach: float = 0.005):
        self.spacing, self.reach = spacing, reach
        self.settings = f"{spacing} {reach}"

    def __call__(self, scene: Scene) -> dict[str, np.ndarray]:
        return {
            "volume": 1e6 * scene.shared_volume(self.spacing),
            "contact": (scene.distances.min(1) < self.reach).astype(float),
        }
