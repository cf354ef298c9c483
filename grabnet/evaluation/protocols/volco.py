"""Protocol `volco` (VolCo, NeurIPS 2026; ref. 9): displacement, depth, volume beside contact area, and hands cut apart.

Its intersection volume is exact; here it is counted in voxels of 1 mm, as in its authors' tables. Its stability is in
`simulated.py`, its clusters are in `diversity.py`.
"""

from __future__ import annotations

from typing import Self

import numpy as np

from grabnet.body.hand import HandModel
from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.metrics import VOLCO, Metric
from grabnet.evaluation.protocol import PerGrasp
from grabnet.evaluation.protocols.walls import interior_of, pieces_of
from grabnet.evaluation.scene import GraspScene
from grabnet.geometry.intersections import MovingMesh
from grabnet.grasping.contact_area import REACH, ContactArea

_SPACING = 0.001  # metres, of voxels


class Volco(PerGrasp):
    """depth: of the deepest vertex, cm; volume: shared by hand and object, cm³; contact_area: of the object's faces,
    cm², as `ContactArea` has it; contact: 1 where any vertex is inside or within 5 mm; pierce_free: 1 where the object
    leaves the hand in one piece.

    Args:
        hand: the model.
    """

    name = "volco"
    metrics = (
        Metric(*("volco", "depth", "cm", "depth of the deepest hand vertex (PD)", "lower"), section=VOLCO),
        Metric(
            *("volco", "volume", "cm³", "centres of 1 mm voxels inside both hand and object (IV)", "lower"),
            section=VOLCO,
            headline=True,
        ),
        Metric(
            *("volco", "contact_area", "cm²"),
            "faces of the object with a corner within 5 mm of the hand whose normals oppose (CA)",
            "higher",
            section=VOLCO,
            headline=True,
        ),
        Metric(
            *("volco", "contact", "%", "share of grasps with a hand vertex inside or within 5 mm (CR)", "higher"),
            section=VOLCO,
        ),
        Metric(
            *("volco", "pierce_free", "%"),
            "share of grasps in which the object leaves the hand in one piece, as a mesh boolean would find it",
            "higher",
            section=VOLCO,
            headline=True,
        ),
    )

    def __init__(self, hand: HandModel):
        self.interior = interior_of(hand)
        self.settings = hand.fingerprint

    @classmethod
    def of(cls, inputs: EvaluationInputs) -> Self:
        return cls(inputs.hand)

    def __call__(self, scene: GraspScene) -> dict[str, np.ndarray]:
        nearest = scene.distances.min(1)
        area = scene.target.kept("contact area", lambda: ContactArea(scene.target.mesh))
        # Each its own tree: which of two equally near faces is found must not depend on hands measured before.
        areas = [1e4 * area(MovingMesh(vertices, scene.hands.faces)) for vertices in scene.hands.vertices]
        return {
            "depth": 100 * np.maximum(-nearest, 0),
            "volume": 1e6 * scene.shared_volume(_SPACING),
            "contact_area": np.array(areas),
            "contact": (nearest < REACH).astype(float),
            "pierce_free": (pieces_of(scene, self.interior) == 1).astype(float),
        }
