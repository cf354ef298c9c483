"""Whether a thumb and what it works against press on an object from opposite sides."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import normalize, one_hot

from grabnet.body.anatomy import FINGERS


def opposition(touching: Tensor, normals: Tensor, finger: Tensor) -> Tensor:
    """(N,) how well thumb and a finger, or the palm, oppose each other; of these the one that does best.

    Minus the cosine between the object's mean normals under the two: 1 opposite, 0 at right angles, -1 side by side;
    0 where the thumb or all others touch nothing.

    Args:
        touching: (N, V) bool, vertices in contact.
        normals: (N, V, 3) outward normals of the object's surface nearest to them; read where they touch.
        finger: (V,) index into `FINGERS`; -1 on palm and wrist.
    """
    members = one_hot(finger.remainder(len(FINGERS) + 1), len(FINGERS) + 1).to(normals)
    under = torch.einsum("nvc,vp->npc", torch.where(touching.unsqueeze(-1), normals, 0.0), members)
    touches = torch.einsum("nv,vp->np", touching.to(normals), members) > 0
    facing = -(normalize(under[:, :1], dim=-1) * normalize(under[:, 1:], dim=-1)).sum(-1)
    both = touches[:, :1] & touches[:, 1:]
    best = facing.masked_fill(~both, -torch.inf).amax(1)
    return torch.where(both.any(1), best, torch.zeros_like(best))
