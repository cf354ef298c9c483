"""Protocol `walls`: whether hands go through the object, as `scripts/sample.py` reports it."""

from __future__ import annotations

from typing import Self

import numpy as np
import torch
from torch import Tensor

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.metrics import FIELD, Metric
from grabnet.evaluation.protocol import PerGrasp
from grabnet.evaluation.scene import GraspScene
from grabnet.grasping.grasp_hand import GraspHand
from grabnet.grasping.interior import Interior
from grabnet.grasping.lines import Lines
from grabnet.grasping.measures import DEFINITIONS, pieces


class Walls(PerGrasp):
    """through: depth through walls, mm; pierced: 1 where the object cuts the hand apart or touches a bone.

    Of hands of other vertices than the model's, whose bones are unknown, only whether they are cut apart is known.

    Args:
        hand: the model.
    """

    name = "walls"
    metrics = (
        Metric(
            *("walls", "through", "mm", DEFINITIONS["through_mm"], "lower"),
            section=FIELD,
            headline=True,
            distribution=True,
            caption="{:.1f} mm through walls",
        ),
        Metric(
            *("walls", "pierced", "%", DEFINITIONS["pierced"], "lower"),
            section=FIELD,
            headline=True,
            mark="goes through",
        ),
    )

    def __init__(self, hand: HandModel):
        self.interior = interior_of(hand)
        self.settings = hand.fingerprint

    @classmethod
    def of(cls, inputs: EvaluationInputs) -> Self:
        return cls(inputs.hand)

    def __call__(self, scene: GraspScene) -> dict[str, np.ndarray]:
        cut = pieces_of(scene, self.interior) > 1
        lines = lines_of(scene, self.interior)
        if lines is None:
            return {"through": np.full(len(cut), np.nan), "pierced": cut.astype(float)}
        return {
            "through": 1e3 * lines.through.amax(1).double().numpy(),
            "pierced": (cut | lines.bone_crosses.numpy()).astype(float),
        }


def interior_of(hand: HandModel) -> Interior:
    """Of the hand's mean shape."""
    betas = hand.shapedirs.new_zeros(hand.shapedirs.shape[-1])
    return Interior.of(GraspHand(hand, Anatomy.of(hand), betas))


def lines_of(scene: GraspScene, interior: Interior) -> Lines | None:
    """Lines inside the hands; None where they have other vertices than the model."""
    vertices = torch.from_numpy(scene.hands.vertices)
    if vertices.shape[1] != interior.weights.shape[1]:
        return None
    return scene.kept("lines", lambda: Lines.of(interior, scene.target.query, vertices, _distances(scene)))


def pieces_of(scene: GraspScene, interior: Interior) -> np.ndarray:
    """(N,) into how many pieces the object cuts each hand, its wrist closed."""
    hands, target = scene.hands, scene.target

    def count() -> Tensor:
        tensors = (torch.from_numpy(x) for x in (hands.vertices, hands.faces))
        return pieces(target.mesh, target.query, *tensors, _distances(scene), lines_of(scene, interior))

    return scene.kept("pieces", count).numpy()


def _distances(scene: GraspScene) -> Tensor:
    return torch.from_numpy(scene.distances).float()
