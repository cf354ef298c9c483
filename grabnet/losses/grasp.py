"""The two networks' losses: which terms, how weighted (ref. 7)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.distributions import Normal

from grabnet.body.hand import HandModel
from grabnet.data.batches import GraspBatch
from grabnet.errors import UserError
from grabnet.geometry.nearest import NearestVertex
from grabnet.losses.edges import EdgeL1
from grabnet.losses.terms import (
    PointWeights,
    hand_to_object_l1,
    kl_to_standard_normal,
    object_to_hand_l1,
    vertex_l1,
)


class ReconstructionLoss(nn.Module):
    """Terms that both networks share: vertices, edges, hand→object distances.

    Args:
        hand: whose mesh edges count.
        contact: (V,) share of training frames in which each vertex touches; normalised here to a maximum of 1.
        vertex, edge, hand_to_object: weights of the terms.
        root: w' = w^(1/root) weighs the distances; higher means more even.
        contact_weights: "learned", w from `contact`, or "uniform", 1 for every vertex.
        vertices_by_root: weigh the vertices by w' too, instead of by w.

    Raises:
        UserError: other contact_weights, or a root that is not positive.
    """

    def __init__(
        self,
        hand: HandModel,
        contact: Tensor,
        vertex: float,
        edge: float,
        hand_to_object: float,
        root: float,
        contact_weights: str,
        vertices_by_root: bool,
    ):
        super().__init__()
        if contact_weights not in ("learned", "uniform"):
            raise UserError(f"contact_weights is '{contact_weights}'; it can be learned or uniform.")
        if root <= 0:
            raise UserError(f"root is {root}; no such root of the contact weights can be taken: it must be above 0.")
        uniform = contact_weights == "uniform"
        likelihood = torch.ones_like(contact) if uniform else contact / contact.max().clamp_min(1e-12)
        evened = likelihood ** (1 / root)
        self.vertex, self.edge, self.hand_to_object = vertex, edge, hand_to_object
        self.register_buffer("vertex_weight", evened if vertices_by_root else likelihood, False)
        self.register_buffer("distance_weight", evened, False)
        self.edges = EdgeL1(hand.faces, len(hand.v_template))

    def forward(self, vertices: Tensor, batch: GraspBatch) -> dict[str, Tensor]:
        """Weighted terms for predicted vertices (B, V, 3)."""
        return {
            "vertex": self.vertex * vertex_l1(vertices, batch.vertices, self.vertex_weight),
            "edge": self.edge * self.edges(vertices, batch.vertices),
            "hand_to_object": self.hand_to_object
            * hand_to_object_l1(batch.objects.distances(vertices), batch.distances, self.distance_weight),
        }


class CoarseNetLoss(ReconstructionLoss):
    """CoarseNet's terms, each × (1 − kl), and kl × the KL divergence.

    Args:
        object_to_hand: weight of the signed object→hand distances, their mean taken over all samples of the object as
            published: those that are left out for being far from the hand count as right.
        point_weights: of each point within it.
        kl: κ, weight of the KL divergence.
    """

    def __init__(
        self,
        hand: HandModel,
        contact: Tensor,
        vertex: float,
        edge: float,
        hand_to_object: float,
        object_to_hand: float,
        kl: float,
        root: float,
        contact_weights: str,
        point_weights: PointWeights,
    ):
        super().__init__(hand, contact, vertex, edge, hand_to_object, root, contact_weights, vertices_by_root=False)
        self.object_to_hand, self.kl, self.point_weights = object_to_hand, kl, point_weights
        self.nearest = NearestVertex(hand.faces, len(hand.v_template))

    def forward(self, vertices: Tensor, batch: GraspBatch, posterior: Normal) -> dict[str, Tensor]:
        terms = super().forward(vertices, batch)
        reached = self.nearest.signed_offset(batch.points, vertices)
        error = object_to_hand_l1(reached, batch.point_distances, self.point_weights)
        terms["object_to_hand"] = self.object_to_hand * batch.point_share * error
        terms = {name: (1 - self.kl) * term for name, term in terms.items()}
        return terms | {"kl": self.kl * kl_to_standard_normal(posterior)}


class RefineNetLoss(ReconstructionLoss):
    """RefineNet's terms, × (1 − kl) as in CoarseNet's loss so that the two stay comparable (ref. 7)."""

    def __init__(
        self,
        hand: HandModel,
        contact: Tensor,
        vertex: float,
        edge: float,
        hand_to_object: float,
        kl: float,
        root: float,
        contact_weights: str,
    ):
        super().__init__(hand, contact, vertex, edge, hand_to_object, root, contact_weights, vertices_by_root=True)
        self.kl = kl

    def forward(self, vertices: Tensor, batch: GraspBatch) -> dict[str, Tensor]:
        return {name: (1 - self.kl) * term for name, term in super().forward(vertices, batch).items()}
