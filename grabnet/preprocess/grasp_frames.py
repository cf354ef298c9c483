"""From recorded frames to the frames store: hand and object about the object's centroid, heading kept (spec 3)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from grabnet.data.sequences import Sequence


def grasp_frames(sequence: Sequence, frames: np.ndarray, centroid: np.ndarray) -> dict[str, Tensor]:
    """The right hand and object in chosen frames, as `write_shard` takes them.

    Args:
        frames: (N,) their numbers.
        centroid: (3,) of the object's mesh, in its own frame.
    """
    hand, thing = sequence.rhand, sequence.object
    origin = thing.to_world(torch.as_tensor(centroid, dtype=torch.float32).view(1, 3), frames)[:, 0]
    return {
        "global_orient": torch.as_tensor(hand.global_orient[frames]),
        "hand_pose": torch.as_tensor(hand.fullpose[frames]),
        "transl": torch.as_tensor(hand.transl[frames]) - origin,
        "object_orient": -torch.as_tensor(thing.global_orient[frames]),  # the store's rotation acts on column vectors
        "frame": torch.as_tensor(frames),
    }
