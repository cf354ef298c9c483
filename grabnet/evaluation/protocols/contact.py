"""Protocol `contact`: which fingers touch, and with how much of their skin."""

from __future__ import annotations

from typing import Self

import numpy as np

from grabnet.body.anatomy import FINGERS
from grabnet.evaluation.hands import HandLabels
from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.metrics import Metric, Section
from grabnet.evaluation.protocol import PerGrasp
from grabnet.evaluation.scene import GraspScene
from grabnet.geometry.mesh import vertex_areas

PARTS = (*FINGERS, "palm")
_CONTACT = Section("Contact")


class FingerContact(PerGrasp):
    """Contact by finger.

    A hand vertex is in contact where it is inside the object or within `distance` of its surface, and stands for a
    third of the area of the faces around it. A finger is in contact with any vertex. area: of the whole hand in
    contact, cm²; area_<finger>; fingers: how many are in contact, 0 … 5; touches_<finger>: 1 where it is; pinched: 1
    where the thumb and another finger are. Hands that have not the model's vertices have only area.

    Args:
        labels: of the hand model.
        distance: metres (ref. 4: 4.5 mm).
    """

    name = "contact"

    def __init__(self, labels: HandLabels, distance: float):
        self.labels = labels
        self.distance = distance
        self.settings = f"{distance}"
        within = f"inside the object or within {1000 * distance:g} mm of it"
        pinched = "share of grasps in which the thumb and another finger touch"
        self.metrics = (
            Metric("contact", "area", "cm²", f"skin {within}", section=_CONTACT),
            Metric(
                *("contact", "fingers", "", f"fingers with a vertex {within}"),
                section=_CONTACT,
                headline=True,
                caption="{:.0f} fingers",
            ),
            Metric("contact", "pinched", "%", pinched, "higher", section=_CONTACT, headline=True),
            *(
                Metric(
                    "contact",
                    f"touches_{p}",
                    "%",
                    f"share of grasps in which the {p} touches",
                    section=_CONTACT,
                    part=p,
                )
                for p in PARTS
            ),
            *(
                Metric("contact", f"area_{p}", "cm²", f"skin of the {p} {within}", section=_CONTACT, part=p)
                for p in PARTS
            ),
        )

    @classmethod
    def of(cls, inputs: EvaluationInputs) -> Self:
        return cls(inputs.labels, inputs.config.contact_distance)

    def __call__(self, scene: GraspScene) -> dict[str, np.ndarray]:
        hands = scene.hands
        area = 1e4 * vertex_areas(hands.vertices, hands.faces) * (scene.distances < self.distance)
        results = {metric.name: np.full(len(hands), np.nan) for metric in self.metrics}
        results["area"] = area.sum(1)
        if self.labels.fit(hands):
            touching = []
            for k, part in enumerate(PARTS):
                members = self.labels.finger == (k if part in FINGERS else -1)
                results[f"area_{part}"] = area[:, members].sum(1)
                touching.append((scene.distances[:, members] < self.distance).any(1))
                results[f"touches_{part}"] = touching[-1].astype(float)
            fingers = np.stack(touching[: len(FINGERS)], 1)
            results["fingers"] = fingers.sum(1).astype(float)
            results["pinched"] = (fingers[:, 0] & fingers[:, 1:].any(1)).astype(float)
        return results
