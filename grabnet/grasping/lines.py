"""Lines inside hands, along the bones and from them to the skin, and where they meet an object."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from grabnet.geometry.queries import MeshQuery
from grabnet.grasping.interior import Interior

_DOUBT = 0.002  # metres by which distances far from the surface may be off


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines inside N hands, one to each of V vertices and E along the bones; exact, however thin a wall is.

    Attributes:
        interior: of the hands.
        points: (N, S, 3) that it finds.
        through: (N, V) metres of the line to each vertex beyond where it first enters the object; all of it where it
            starts inside.
        clear: (N, V) bool, lines to vertices that lie outside the object and do not touch it.
        chain_clear: (N, E) bool, the same of lines along the bones.
    """

    interior: Interior
    points: Tensor
    through: Tensor
    clear: Tensor
    chain_clear: Tensor

    @classmethod
    def of(cls, interior: Interior, query: MeshQuery, vertices: Tensor, distances: Tensor) -> Lines:
        """Args:
        interior: of the hands.
        query: of the object, on the CPU.
        vertices: (N, V, 3) metres, in its frame.
        distances: (N, V) signed, to it; may be infinite, and off by 2 mm, farther than 2 cm from it.
        """
        points = interior.points(vertices)
        inside = (query.signed_distance(points.flatten(0, 1)) < 0).view(points.shape[:2])
        foot, foot_inside = points[:, interior.foot], inside[:, interior.foot]
        length = (vertices - foot).norm(dim=-1)
        # A line shorter than the way to the object does not meet it.
        near = distances < length + _DOUBT
        share = torch.full_like(length, torch.inf)
        share[near] = query.first_hit(foot[near], vertices[near])
        through = torch.where(foot_inside, length, (1 - share).clamp_min(0) * length)
        # Openings are closed by no face that a line would hit.
        through = torch.maximum(through, -distances.to(through)).clamp_min(0)
        start, end = interior.chain.T
        hits = query.first_hit(points[:, start].flatten(0, 1), points[:, end].flatten(0, 1)).view(len(points), -1)
        chain_clear = hits.isinf() & ~inside[:, start] & ~inside[:, end]
        return cls(interior, points, through, share.isinf() & ~foot_inside & (distances >= 0), chain_clear)

    @property
    def bone_crosses(self) -> Tensor:
        """(N,) bool: the object touches a bone."""
        return ~self.chain_clear.all(1)

    def select(self, index: Tensor) -> Lines:
        """The chosen hands'."""
        per_hand = ("points", "through", "clear", "chain_clear")
        return replace(self, **{name: getattr(self, name)[index] for name in per_hand})

    def joined(self, first_point: int) -> list[np.ndarray]:
        """Of each hand (L, 2) what clear lines join: its vertices, and from `first_point` on the points inside it."""
        vertices = np.arange(self.clear.shape[1])
        to_skin = np.stack([vertices, first_point + self.interior.foot.numpy()], 1)
        along = first_point + self.interior.chain.numpy()
        clear = zip(self.clear.numpy(), self.chain_clear.numpy(), strict=True)
        return [np.concatenate([to_skin[skin], along[bones]]) for skin, bones in clear]
