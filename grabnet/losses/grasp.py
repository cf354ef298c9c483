"""The two networks' losses: which terms, how weighted (ref. 7)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.distributions import Normal

from grabnet.body.hand import HandModel
from grabnet.cli.checks import Share, Weight
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
        weight_exponent: w' = w^weight_exponent weighs the distances; lower means more even.
        contact_weights: "learned", w from `contact`, or "uniform", 1 for every vertex.
        evened_vertices: weigh the vertices by w' too, instead of by w.

    Raises:
        UserError: other contact_weights, or a weight_exponent that is negative.
    """

    def __init__(
        self,
        hand: HandModel,
        contact: Tensor,
        vertex: Weight,
        edge: Weight,
        hand_to_object: Weight,
        weight_exponent: Weight,
        contact_weights: str,
        evened_vertices: bool,
    ):
        super().__init__()
        if contact_weights not in ("learned", "uniform"):
            raise UserError(f"contact_weights is '{contact_weights}'; it can be learned or uniform.")
        if not weight_exponent >= 0:
            raise UserError(f"weight_exponent is {weight_exponent}; it must be at least 0.")
        uniform = contact_weights == "uniform"
        likelihood = torch.ones_like(contact) if uniform else contact / contact.max().clamp_min(1e-12)
        evened = likelihood**weight_exponent
        self.vertex, self.edge, self.hand_to_object = vertex, edge, hand_to_object
        self.register_buffer("vertex_weight", evened if evened_vertices else likelihood, False)
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
        object_to_hand: weight of the signed object→hand distances.
        point_weights: of each point within it.
        kl: κ, weight of the KL divergence.
    """

    def __init__(
        self,
        hand: HandModel,
        contact: Tensor,
        vertex: Weight,
        edge: Weight,
        hand_to_object: Weight,
        object_to_hand: Weight,
        kl: Share,
        weight_exponent: Weight,
        contact_weights: str,
        point_weights: PointWeights,
    ):
        super().__init__(
            hand, contact, vertex, edge, hand_to_object, weight_exponent, contact_weights, evened_vertices=False
        )
        self.object_to_hand, self.kl, self.point_weights = object_to_hand, kl, point_weights
        self.nearest = NearestVertex(hand.faces, hand.v_template)

    def forward(self, vertices: Tensor, batch: GraspBatch, posterior: Normal) -> dict[str, Tensor]:
        terms = super().forward(vertices, batch)
        reached = self.nearest.signed_offset(batch.points, vertices)
        error = object_to_hand_l1(reached, batch.point_distances, self.point_weights)
        terms["object_to_hand"] = self.object_to_hand * error
        terms = {name: (1 - self.kl) * term for name, term in terms.items()}
        return terms | {"kl": self.kl * kl_to_standard_normal(posterior)}


class RefineNetLoss(ReconstructionLoss):
    """RefineNet's terms (ref. 7).

    Args:
        scale: of all terms; 1 − κ of CoarseNet's loss keeps the two comparable.
    """

    def __init__(
        self,
        hand: HandModel,
        contact: Tensor,
        vertex: Weight,
        edge: Weight,
        hand_to_object: Weight,
        scale: Weight,
        weight_exponent: Weight,
        contact_weights: str,
    ):
        super().__init__(
            hand, contact, vertex, edge, hand_to_object, weight_exponent, contact_weights, evened_vertices=True
        )
        self.scale = scale

    def forward(self, vertices: Tensor, batch: GraspBatch) -> dict[str, Tensor]:
        return {name: self.scale * term for name, term in super().forward(vertices, batch).items()}
