"""Protocol `halo` (Karunratanakul et al. 2021; ref. 9): volume, depth and contact of closed hands with the object."""

from __future__ import annotations

import numpy as np

from grabnet.evaluation.metrics import Metric
from grabnet.evaluation.scene import Scene


class Halo:
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
        self.metrics = (
            Metric("halo", "volume", "cm³", "centres of 1 mm voxels inside both hand and object", "lower", samples),
            Metric("halo", "depth", "cm", "depth of the deepest hand vertex inside the object", "lower", samples),
            Metric("halo", "contact", "%", "share of grasps with a hand vertex inside the object", "higher", samples),
        )

    def __call__(self, scene: Scene) -> dict[str, np.ndarray]:
        nearest = scene.distances.min(1)
        return {
            "volume": 1e6 * scene.shared_volume(self.spacing),
            "depth": 100 * np.maximum(-nearest, 0),
            "contact": (nearest < 0).astype(float),
        }
