"""Hands before an object, as the energy's terms see them: distances of skin and spheres, and the state of each pad."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import normalize

from grabnet.grasping.grasp_hand import GraspHand, GraspPose, Sampled
from grabnet.grasping.surface import Surface


class Pads(NamedTuple):
    """The P pads of B hands, each as the mean of its K vertices, weighted towards those deepest in the object.

    gap (B, P, K) mm to the object; share (B, P, K) of each vertex, sums of 1; place (B, P, 3) metres; surface
    (B, P, 3) unit normals of the object there; facing (B, P, 3) unit normals of the skin.
    """

    gap: Tensor
    share: Tensor
    place: Tensor
    surface: Tensor
    facing: Tensor

    @property
    def distance(self) -> Tensor:
        """(B, P) mm."""
        return (self.share * self.gap).sum(-1)


class Seen(NamedTuple):
    """B hands: what stands for them, its signed distances to the object, mm, and their pads.

    skin (B, N), spheres (B, S), forearm (B, 5).
    """

    sampled: Sampled
    skin: Tensor
    spheres: Tensor
    forearm: Tensor
    pads: Pads

    @classmethod
    def of(cls, hand: GraspHand, pose: GraspPose, surface: Surface, softness: float) -> Seen:
        """Args:
        softness: mm, over which a pad is spread among its vertices; low: only the deepest counts.
        """
        points, sampled = hand.sampled(pose)
        distance, normal = surface(points)
        skin, spheres, forearm = (1e3 * distance).split([x.shape[1] for x in sampled[:3]], 1)
        n, shape = hand.pads.numel(), hand.pads.shape
        gap = skin[:, :n].unflatten(1, shape)
        share = torch.where(hand.pad_mask, -gap.detach() / softness, -1e4).softmax(-1)

        def of_pads(values: Tensor) -> Tensor:
            return (share.unsqueeze(-1) * values).sum(2)

        facing = normalize(of_pads(sampled.facing), dim=-1)
        normal = normalize(of_pads(normal[:, :n].unflatten(1, shape)), dim=-1)
        place = of_pads(sampled.skin[:, :n].unflatten(1, shape))
        return cls(sampled, skin, spheres, forearm, Pads(gap, share, place, normal, facing))
