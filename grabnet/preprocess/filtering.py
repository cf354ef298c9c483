"""Which frames of a recording show a right hand grasping, by the paper's rules (S.9.1; spec 3)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from grabnet.data.sequences import N_PARTS, Sequence

# Contact labels (spec 1): of each finger's three phalanges, and of the hand with them.
RIGHT_FINGERS = {
    "index": (41, 42, 43),
    "middle": (44, 45, 46),
    "pinky": (47, 48, 49),
    "ring": (50, 51, 52),
    "thumb": (53, 54, 55),
}
RIGHT_HAND = (22, *range(41, 56))
LEFT_HAND = (21, *range(26, 41))


@dataclass(frozen=True)
class FrameFilter:
    """The rules, each with its threshold; the values of `configs/filter/paper.yaml`.

    Args:
        right_hand: the right hand touches the object.
        left_hand_free: the left hand doesn't.
        min_lift: metres that the object is above or below where it was in the first frame, at least.
        thumb: the right thumb touches.
        min_other_fingers: other right fingers that touch, at least.
        min_finger_vertices: object vertices that a finger touches, at least, to count as touching.
        every: n, to use only every n-th frame of a sequence.
    """

    right_hand: bool
    left_hand_free: bool
    min_lift: float
    thumb: bool
    min_other_fingers: int
    min_finger_vertices: int
    every: int

    def passed(self, sequence: Sequence) -> dict[str, np.ndarray]:
        """(T,) bool for each rule, in the order in which they are applied; a rule switched off passes all."""
        counts = part_counts(sequence.contact.object)
        height = sequence.object.transl[:, 2]
        touching = {
            finger: counts[:, list(parts)].sum(1) >= self.min_finger_vertices for finger, parts in RIGHT_FINGERS.items()
        }
        others = sum(touching[finger].astype(int) for finger in RIGHT_FINGERS if finger != "thumb")
        return {
            "every": np.arange(len(sequence)) % self.every == 0,
            "right_hand": (counts[:, list(RIGHT_HAND)].any(1)) | (not self.right_hand),
            "left_hand_free": ~counts[:, list(LEFT_HAND)].any(1) | (not self.left_hand_free),
            "min_lift": np.abs(height - height[0]) >= self.min_lift,
            "thumb": touching["thumb"] | (not self.thumb),
            "min_other_fingers": others >= self.min_other_fingers,
        }

    def keep(self, sequence: Sequence) -> np.ndarray:
        """(N,) numbers of the frames that pass every rule."""
        return np.logical_and.reduce(list(self.passed(sequence).values())).nonzero()[0]


@dataclass
class Waterfall:
    """How many frames each rule takes away from those that the rules before it left.

    Attributes:
        counts: of frames "in all", and left after each rule, by (split, intent, object) and then by rule.
    """

    counts: dict[tuple[str, str, str], Counter[str]] = field(default_factory=dict)

    def add(self, sequence: Sequence, split: str, passed: Mapping[str, np.ndarray]) -> None:
        """Count one sequence's frames; `passed` is what `FrameFilter.passed` said of it."""
        counter = self.counts.setdefault((split, sequence.motion_intent, sequence.obj_name), Counter())
        left = np.ones(len(sequence), bool)
        counter["in all"] += len(sequence)
        for rule, mask in passed.items():
            left = left & mask
            counter[rule] += int(left.sum())

    def by(self, *aspects: str) -> dict[tuple[str, ...], dict[str, int]]:
        """Frames left after each rule, in groups.

        Args:
            aspects: any of "split", "intent", "object"; none for all frames together.
        """
        position = [("split", "intent", "object").index(aspect) for aspect in aspects]
        groups: dict[tuple[str, ...], Counter[str]] = {}
        for key, counter in sorted(self.counts.items()):
            groups.setdefault(tuple(key[i] for i in position), Counter()).update(counter)
        return {key: dict(counter) for key, counter in groups.items()}


def part_counts(labels: np.ndarray) -> np.ndarray:
    """(T, V) contact labels → (T, 56) vertices with each label, 0 included."""
    return np.stack([np.bincount(frame, minlength=N_PARTS + 1) for frame in labels])
