"""Protocol `penetration`: how deep hand vertices are in the object, as `scripts/sample.py` reports it."""

from __future__ import annotations

import numpy as np
import torch

from grabnet.contact.contacts import Contacts
from grabnet.evaluation.metrics import Metric
from grabnet.evaluation.scene import Scene
from grabnet.generation.grasps import DEFINITIONS


class Penetration:
    """Depth of the deepest hand vertex, and mean depth over those inside; mm, 0 where none is (`grasps.Contacts`)."""

    name = "penetration"
    settings = ""
    metrics = (
        Metric("penetration", "max", "mm", DEFINITIONS["max_penetration_mm"], "lower"),
        Metric("penetration", "mean", "mm", DEFINITIONS["mean_penetration_mm"], "lower"),
    )

    def __call__(self, scene: Scene) -> dict[str, np.ndarray]:
        distances = torch.from_numpy(scene.distances)
        contacts = Contacts(distances=distances, finger=torch.zeros(distances.shape[1], dtype=torch.int64))
        return {
            "max": 1000 * contacts.max_penetration.numpy(),
            "mean": 1000 * contacts.mean_penetration.numpy(),
        }
