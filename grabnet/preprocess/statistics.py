"""What touches in the frames of a recording, counted so that recordings can be added up."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from grabnet.body.skeleton import HEAD_PARTS, LEFT_HAND_PARTS, N_PARTS, PARTS, RIGHT_HAND_PARTS
from grabnet.data.sequences import Sequence
from grabnet.preprocess.filtering import part_counts, touching

# The paper's contact frames (3.5; ref. 8): the object so far from its first height, so many body vertices in
# contact.
_LIFTED, _BODY_VERTICES = 0.005, 50

Counts = dict[str, int]


def finger_counts(labels: np.ndarray) -> Counts:
    """Of frames (N, V) of object labels: how many "frames" there are, and in how many each part of the right hand
    touches."""
    counts = part_counts(labels)
    palm = counts[:, PARTS["right_wrist"]] > 0
    parts = {finger: mask.sum() for finger, mask in touching(counts).items()} | {"palm": palm.sum()}
    return {"frames": len(labels)} | {part: int(n) for part, n in parts.items()}


def contact_counts(sequence: Sequence) -> Counts:
    """How many of a recording's frames are the paper's "contact frames", and which parts touch in these.

    Fingers and palm are counted among those frames that the right hand takes part in.
    """
    height = sequence.object.transl[:, 2]
    lifted = np.abs(height - height[0]) >= _LIFTED
    labels = sequence.contact.object[lifted & ((sequence.contact.body > 0).sum(1) >= _BODY_VERTICES)]
    counts = part_counts(labels)
    right, left, head = (counts[:, list(parts)].any(1) for parts in (RIGHT_HAND_PARTS, LEFT_HAND_PARTS, HEAD_PARTS))
    who = {"right_hand": right, "left_hand": left, "both_hands": right & left, "head": head}
    parts = finger_counts(labels[right])
    del parts["frames"]
    return {"frames": len(labels)} | {name: int(mask.sum()) for name, mask in who.items()} | parts


def overlap(one: np.ndarray, other: np.ndarray) -> dict[int, list[int]]:
    """Two annotations (T, V): for each part that either has, how many labels both have, and how many either has."""
    both = np.bincount(one[one == other], minlength=N_PARTS + 1)
    either = np.bincount(one.ravel(), minlength=N_PARTS + 1) + np.bincount(other.ravel(), minlength=N_PARTS + 1) - both
    return {part: [int(both[part]), int(either[part])] for part in range(1, N_PARTS + 1) if either[part]}


def agreement(overlaps: Iterable[Mapping[int, list[int]]]) -> dict[int, float]:
    """Intersection over union of each part, of all recordings whose `overlap` is given."""
    total: dict[int, np.ndarray] = {}
    for each in overlaps:
        for part, counts in each.items():
            total[int(part)] = total.get(int(part), 0) + np.array(counts)
    return {part: float(both / either) for part, (both, either) in sorted(total.items())}
