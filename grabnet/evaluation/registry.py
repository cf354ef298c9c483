"""The protocols of the evaluation, in the order of all tables."""

from __future__ import annotations

from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.protocol import EvaluationProtocol
from grabnet.evaluation.protocols.contact import FingerContact
from grabnet.evaluation.protocols.contact_maps import ContactMaps
from grabnet.evaluation.protocols.diversity import Coverage, Diversity, Novelty, WhitenedDiversity
from grabnet.evaluation.protocols.grasptta import GraspTTA
from grabnet.evaluation.protocols.ground_truth import ClosestHand, ClosestMap
from grabnet.evaluation.protocols.halo import Halo
from grabnet.evaluation.protocols.penetration import Penetration
from grabnet.evaluation.protocols.posture import Posture
from grabnet.evaluation.protocols.reconstruction import Reconstruction
from grabnet.evaluation.protocols.simulated import Displacement, Shake, Stability
from grabnet.evaluation.protocols.volco import Volco
from grabnet.evaluation.protocols.walls import Walls

PROTOCOLS: list[type[EvaluationProtocol]] = [
    Reconstruction,
    ClosestHand,
    ClosestMap,
    Halo,
    GraspTTA,
    Displacement,
    Shake,
    Penetration,
    Walls,
    Volco,
    Stability,
    WhitenedDiversity,
    FingerContact,
    Posture,
    ContactMaps,
    Diversity,
    Novelty,
    Coverage,
]


def protocols_of(inputs: EvaluationInputs) -> list[EvaluationProtocol]:
    """Return the protocols that an evaluation's settings ask for.

    Raises:
        ValueError: two metrics of one title, or a metric of another protocol's name.
    """
    protocols = [made for protocol in PROTOCOLS if (made := protocol.of(inputs)) is not None]
    titles = set()
    for protocol in protocols:
        for metric in protocol.metrics:
            if metric.protocol != protocol.name:
                raise ValueError(f"{metric.title} is a metric of {type(protocol).__name__}, named {protocol.name}")
            if metric.title in titles:
                raise ValueError(f"{metric.title} is measured twice, the second time by {type(protocol).__name__}")
            titles.add(metric.title)
    return protocols
