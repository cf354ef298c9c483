"""What a statistic reads of a sequence: what touches in each frame, how far the object is lifted, and the hands."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from torch import Tensor

from grabnet.body.skeleton import HEAD_PARTS, LEFT_HAND_PARTS, RIGHT_FINGER_PARTS, RIGHT_HAND_PARTS
from grabnet.geometry.queries import MeshQuery
from grabnet.preprocess.filtering import part_counts

# Hands posed at once.
_BATCH = 256


class Group(NamedTuple):
    """What a sequence is counted under."""

    intent: str
    subject: str
    object: str


@dataclass(frozen=True)
class Subset:
    """Groups chosen by name; None chooses all."""

    intents: Collection[str] | None = None
    subjects: Collection[str] | None = None
    objects: Collection[str] | None = None

    def __contains__(self, group: Group) -> bool:
        chosen = (self.intents, self.subjects, self.objects)
        return all(names is None or name in names for names, name in zip(chosen, group, strict=True))

    def __str__(self) -> str:
        """Words, as in "intents use; objects mug, cup"."""
        named = {"intents": self.intents, "subjects": self.subjects, "objects": self.objects}
        said = [f"{what} {', '.join(names) or 'none'}" for what, names in named.items() if names is not None]
        return "; ".join(said) or "all"


# Poses the hand of chosen frames (N,): (N, V, 3) metres, in the object's frame.
PosedHand = Callable[[np.ndarray], Tensor]


@dataclass(frozen=True, eq=False)
class Frames:
    """T frames of a sequence.

    Attributes:
        name: of the sequence.
        group: what it counts under.
        object: (T, V of the object) uint8, the part that touches each vertex, 0 for none (ref. 1).
        body: (T, V of the body) uint8, the own part of each touching vertex, 0 for the others.
        lift: (T,) metres that the object is above or below its first place; infinite where it is not recorded.
        hands: the right hand, and the left one where there is one.
        solid: the object in its own frame, made on demand.
        hand_length: metres, the longest side of the subject's right hand at rest.
    """

    name: str
    group: Group
    object: np.ndarray
    body: np.ndarray
    lift: np.ndarray
    hands: Sequence[PosedHand]
    solid: Callable[[], MeshQuery]
    hand_length: float

    def __len__(self) -> int:
        return len(self.lift)

    @cached_property
    def counts(self) -> np.ndarray:
        """(T, 56) vertices of the object that each part touches, 0 for none."""
        return part_counts(self.object)

    @cached_property
    def body_vertices(self) -> np.ndarray:
        """(T,) vertices of the body in contact."""
        return np.count_nonzero(self.body, axis=1)

    def contact_frames(self, min_lift: float, min_body_vertices: int) -> np.ndarray:
        """(T,) bool: the paper's contact frames (3.5; ref. 8)."""
        return (np.abs(self.lift) >= min_lift) & (self.body_vertices >= min_body_vertices)

    def touching(self, parts: Sequence[int], least: int = 1) -> np.ndarray:
        """(T,) bool: these parts together touch at least so many vertices of the object."""
        return self.counts[:, list(parts)].sum(1) >= least

    def depths(self, frames: np.ndarray) -> np.ndarray:
        """(N, V of all hands) metres that vertices of the hands are inside the object in chosen frames; 0 outside."""
        parts = []
        for start in range(0, len(frames), _BATCH):
            chosen = frames[start : start + _BATCH]
            batch = []
            for hand in self.hands:
                vertices = hand(chosen)
                distance = self.solid().signed_distance(vertices.reshape(-1, 3))
                batch.append((-distance).clamp_min(0).reshape(len(chosen), -1).numpy())
            parts.append(np.concatenate(batch, 1))
        return np.concatenate(parts) if parts else np.zeros((0, 1), np.float32)


WHO = {"right hand": RIGHT_HAND_PARTS, "left hand": LEFT_HAND_PARTS, "head": HEAD_PARTS}
# Parts of the right hand, thumb to pinky, then the palm, in the order of the paper (3.5).
FINGER_PARTS = {finger: RIGHT_FINGER_PARTS[finger] for finger in ("thumb", "index", "middle", "ring", "pinky")} | {
    "palm": RIGHT_HAND_PARTS[:1]
}
