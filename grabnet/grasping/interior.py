"""Points inside a hand, found from its skin alone: where its bones are, whatever posed the skin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.sparse.csgraph import minimum_spanning_tree
from torch import Tensor

from grabnet.body.skinning import homogeneous
from grabnet.grasping.grasp_hand import GraspHand, GraspPose, Posed

_UNIT = 0.02  # metres in which places are counted, so that they weigh about as much as the ones beside them


@dataclass(frozen=True, eq=False)
class Interior:
    """The spheres' centres of a `GraspHand` as fixed linear combinations of its skin's vertices.

    For this shape they are exactly where the bones carry them in any pose; for other shapes of the model within 1 mm on
    average, and inside. So they are known of recorded hands, and of mirror images, from vertices alone.

    Attributes:
        weights: (S, V), rows that sum to 1.
        foot: (V,) the point inside that each vertex covers.
        chain: (S - 1, 2) pairs of points that follow each other along the bones.
    """

    weights: Tensor
    foot: Tensor
    chain: Tensor

    @classmethod
    def of(cls, hand: GraspHand) -> Interior:
        flat = GraspPose(torch.eye(3).to(hand.rest)[None], hand.joints[:1], hand.rest.new_zeros(1, 21))
        centres = hand.posed(flat).spheres[0]
        skin, inner = (homogeneous((x - hand.joints[0]).double().cpu() / _UNIT) for x in (hand.rest, centres))
        bone = hand.sphere_bone.cpu()
        # Skinning carries a sum of vertices by every bone's share in it. Of the sums in which the centre's own bone has
        # all of the share, and it lies at the centre, the one of least weights.
        shares = (hand.weights.double().cpu().unsqueeze(-1) * skin.unsqueeze(1)).flatten(1)  # (V, J·4)
        aim = inner.new_zeros(len(inner), hand.weights.shape[1], 4)
        aim[torch.arange(len(inner)), bone] = inner
        weights = aim.flatten(1) @ torch.linalg.pinv(shares, rtol=1e-6)
        chain = _chain(centres.cpu(), bone)
        return cls(weights.to(hand.rest), hand.foot, chain.to(hand.rest.device))

    def points(self, vertices: Tensor) -> Tensor:
        """(N, S, 3) of hands (N, V, 3)."""
        return self.weights.to(vertices) @ vertices

    def posed(self, vertices: Tensor) -> Posed:
        """Hands (N, V, 3) as `GraspHand.posed` gives them, without forearm and rotations."""
        points = self.points(vertices)
        return Posed(vertices, points, points[:, :0], points[:, :0].unsqueeze(-1))


def _chain(centres: Tensor, bone: Tensor) -> Tensor:
    """(S - 1, 2) the shortest tree, of edges within a bone or between one and that on which it hangs."""
    above = torch.where((bone - 1) % 3 > 0, bone - 1, 0)  # first joints of fingers hang on the wrist, 0
    joined = (bone.unsqueeze(1) == bone) | (above.unsqueeze(1) == bone) | (bone.unsqueeze(1) == above)
    tree = minimum_spanning_tree((torch.cdist(centres, centres) * joined).double().numpy()).tocoo()
    return torch.from_numpy(np.stack([tree.row, tree.col], 1).astype(np.int64))
