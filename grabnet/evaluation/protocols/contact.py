"""Protocol `contact`: which fingers touch, and with how much of their skin."""

from __future__ import annotations

import numpy as np

from grabnet.body.anatomy import FINGERS
from grabnet.evaluation.hands import HandLabels
from grabnet.evaluation.metrics import Metric
from grabnet.evaluation.scene import Scene

PARTS = (*FINGERS, "palm")


class FingerContact:
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
        self.labels, self.distance = labels, distance
        self.settings = f"{distance}"
        within = f"inside the object or within {1000 * distance:g} mm of it"
        self.metrics = (
            Metric("contact", "area", "cm²", f"skin {within}"),
            Metric("contact", "fingers", "", f"fingers with a vertex {within}"),
            Metric("contact", "pinched", "%", "share of grasps in which the thumb and another finger touch", "higher"),
            *(Metric("contact", f"touches_{p}", "%", f"share of grasps in which the {p} touches") for p in PARTS),
            *(Metric("contact", f"area_{p}", "cm²", f"skin of the {p} {within}") for p in PARTS),
        )

    def __call__(self, scene: Scene) -> dict[str, np.ndarray]:
        hands = scene.hands
        area = 1e4 * vertex_areas(hands.vertices, hands.faces) * (scene.distances < self.distance)
        found = {metric.name: np.full(len(hands), np.nan) for metric in self.metrics}
        found["area"] = area.sum(1)
        if self.labels.fit(hands):
            touching = []
            for k, part in enumerate(PARTS):
                members = self.labels.finger == (k if part in FINGERS else -1)
                found[f"area_{part}"] = area[:, members].sum(1)
                touching.append((scene.distances[:, members] < self.distance).any(1))
                found[f"touches_{part}"] = touching[-1].astype(float)
            fingers = np.stack(touching[: len(FINGERS)], 1)
            found["fingers"] = fingers.sum(1).astype(float)
            found["pinched"] = (fingers[:, 0] & fingers[:, 1:].any(1)).astype(float)
        return found


def vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(..., V) float64: a third of the area of the faces (F, 3) around each of vertices (..., V, 3)."""
    a, b, c = np.moveaxis(np.asarray(vertices, np.float64)[..., faces, :], -2, 0)
    third = np.linalg.norm(np.cross(b - a, c - a), axis=-1) / 6
    areas = np.zeros(vertices.shape[:-1])
    flat, shares = areas.reshape(-1, areas.shape[-1]), third.reshape(-1, third.shape[-1])
    for row, share in zip(flat, shares, strict=True):
        row += np.bincount(faces.ravel(), np.repeat(share, 3), minlength=len(row))
    return areas
