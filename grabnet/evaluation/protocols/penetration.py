"""Protocol `penetration`: how deep hand vertices are in the object, as `scripts/sample.py` reports it."""

from __future__ import annotations

import numpy as np
import torch

from grabnet.contact.contacts import DEFINITIONS, Contacts
from grabnet.evaluation.metrics import FIELD, Metric
from grabnet.evaluation.protocol import PerGrasp
from grabnet.evaluation.scene import GraspScene

_MAX = DEFINITIONS["max_penetration_mm"]
_MEAN = DEFINITIONS["mean_penetration_mm"]


class Penetration(PerGrasp):
    """Depth of the deepest hand vertex, and mean depth over those inside; mm, 0 where none is (`contact.Contacts`)."""

    name = "penetration"
    metrics = (
        Metric(
            *("penetration", "max", "mm", _MAX, "lower"),
            section=FIELD,
            headline=True,
            distribution=True,
            caption="{:.1f} mm deep",
        ),
        Metric("penetration", "mean", "mm", _MEAN, "lower", section=FIELD),
    )

    def __call__(self, scene: GraspScene) -> dict[str, np.ndarray]:
        distances = torch.from_numpy(scene.distances)
        contacts = Contacts(distances=distances, finger=torch.zeros(distances.shape[1], dtype=torch.int64))
        return {
            "max": 1000 * contacts.max_penetration.numpy(),
            "mean": 1000 * contacts.mean_penetration.numpy(),
        }
