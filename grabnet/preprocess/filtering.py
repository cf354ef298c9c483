"""Which frames of a recording show a right hand grasping, by the paper's rules (S.9.1; ref. 3)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from grabnet.body.skeleton import LEFT_HAND_PARTS, N_PARTS, RIGHT_FINGER_PARTS, RIGHT_HAND_PARTS
from grabnet.cli.checks import Amount, Count, Weight, in_range, one_of
from grabnet.errors import UserError
from grabnet.preprocess.grasp_track import GraspTrack


@dataclass(frozen=True)
class FrameFilter:
    """The rules, each with its threshold; the values of `configs/preprocess/filter/paper.yaml`.

    Args:
        right_hand: the right hand touches the object.
        left_hand_free: the left hand doesn't.
        min_lift: metres of `height`, up or down, at least.
        height: "frame0", of the object's origin above where it was in the first frame; or "table", of the object's
            lowest point above the table.
        thumb: the right thumb touches.
        min_other_fingers: other right fingers that touch, at least.
        min_finger_vertices: object vertices that a finger touches, at least, to count as touching.
        every: n, to use only every n-th frame of a sequence.
        mirror_left: use the left hand's grasps as well, mirrored; the filter itself sees right hands only.

    Raises:
        UserError: a value out of range.
    """

    right_hand: bool
    left_hand_free: bool
    min_lift: Weight
    thumb: bool
    min_other_fingers: Amount
    min_finger_vertices: Count
    every: Count
    height: str
    mirror_left: bool

    def __post_init__(self):
        one_of(self, "filter.", height=("frame0", "table"))
        in_range(self, "filter.")
        if self.min_other_fingers > (most := len(RIGHT_FINGER_PARTS) - 1):
            raise UserError(f"filter.min_other_fingers is {self.min_other_fingers}; there are {most}.")

    def passed(self, track: GraspTrack, gap: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """(T,) bool for each rule, in the order in which they are applied; a rule switched off passes all.

        Args:
            gap: (T,) metres, `gap_to_table`; used where `height` is "table".
        """
        counts = part_counts(track.labels)
        above = track.object.transl[:, 2]
        lift = gap if self.height == "table" else above - above[0]
        fingers = touching(counts, self.min_finger_vertices)
        others = sum(fingers[finger].astype(int) for finger in RIGHT_FINGER_PARTS if finger != "thumb")
        return {
            "every": np.arange(len(track)) % self.every == 0,
            "right_hand": (counts[:, list(RIGHT_HAND_PARTS)].any(1)) | (not self.right_hand),
            "left_hand_free": ~counts[:, list(LEFT_HAND_PARTS)].any(1) | (not self.left_hand_free),
            "min_lift": np.abs(lift) >= self.min_lift,
            "thumb": fingers["thumb"] | (not self.thumb),
            "min_other_fingers": others >= self.min_other_fingers,
        }


@dataclass
class Waterfall:
    """How many frames each rule takes away from those that the rules before it left.

    Attributes:
        counts: of frames "in all", and left after each rule, by (split, intent, object) and then by rule.
    """

    counts: dict[tuple[str, str, str], Counter[str]] = field(default_factory=dict)

    def add(self, split: str, intent: str, thing: str, left: Mapping[str, int]) -> None:
        """Count one sequence's frames; `left` is what `frames_left` said of it."""
        self.counts.setdefault((split, intent, thing), Counter()).update(left)

    def by(self, *aspects: str) -> dict[tuple[str, ...], dict[str, int]]:
        """Frames left after each rule, in groups.

        Args:
            aspects: any of "split", "intent", "object"; none for all frames together.
        """
        position = [("split", "intent", "object").index(aspect) for aspect in aspects]
        groups: dict[tuple[str, ...], Counter[str]] = {}
        for key, counter in self.counts.items():
            groups.setdefault(tuple(key[i] for i in position), Counter()).update(counter)
        return {key: dict(counter) for key, counter in sorted(groups.items())}


def frames_left(passed: Mapping[str, np.ndarray]) -> dict[str, int]:
    """How many frames there are "in all", and how many each rule leaves of those that the rules before it left."""
    masks = list(passed.values())
    left = np.logical_and.accumulate(masks).sum(1).tolist()
    return {"in all": len(masks[0])} | dict(zip(passed, left, strict=True))


def touching(counts: np.ndarray, least: int = 1) -> dict[str, np.ndarray]:
    """(T,) bool for each right finger: whether it touches at least so many vertices of (T, 56) `part_counts`."""
    return {finger: counts[:, list(parts)].sum(1) >= least for finger, parts in RIGHT_FINGER_PARTS.items()}


def part_counts(labels: np.ndarray) -> np.ndarray:
    """(T, V) contact labels → (T, 56) vertices with each label, 0 included."""
    counts = [np.bincount(frame, minlength=N_PARTS + 1) for frame in labels]
    return np.array(counts, int).reshape(-1, N_PARTS + 1)
