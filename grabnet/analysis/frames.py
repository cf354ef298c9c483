"""What a statistic reads of a sequence: what touches in each frame, how far the object is lifted, and the hands."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from grabnet.body.skeleton import HEAD_PARTS, LEFT_HAND_PARTS, PARTS, RIGHT_FINGER_PARTS, RIGHT_HAND_PARTS
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.preprocess.filtering import part_counts

# Frames posed at once.
_BATCH = 64


class Group(NamedTuple):
    """What a sequence is counted under; empty what is not known of it, or not distinguished."""

    intent: str
    subject: str
    object: str

    def merged(self, by: Collection[str]) -> Group:
        """The group without what is not distinguished."""
        return Group(*(value if field in by else "" for field, value in self._asdict().items()))


@dataclass(frozen=True)
class Subset:
    """Groups chosen by name; None chooses all. What is not known of a group does not leave it out."""

    intents: Collection[str] | None = None
    subjects: Collection[str] | None = None
    objects: Collection[str] | None = None

    def __contains__(self, group: Group) -> bool:
        return all(getattr(group, field) in ("", *names) for field, names in self.by.items())

    @property
    def by(self) -> dict[str, Collection[str]]:
        """The names chosen, by the field of `Group` that they are of; none of fields of which all are."""
        chosen = zip(Group._fields, (self.intents, self.subjects, self.objects), strict=True)
        return {field: names for field, names in chosen if names is not None}

    def missing(self, groups: Collection[Group]) -> list[str]:
        """Names chosen that no group has, as in "object mgu"."""
        there = {field: {getattr(group, field) for group in groups} for field in self.by}
        return [f"{field} {name}" for field, names in self.by.items() for name in names if name not in there[field]]

    def __str__(self) -> str:
        """Words, as in "intents use; objects mug, cup"."""
        return "; ".join(f"{field}s {', '.join(names) or 'none'}" for field, names in self.by.items()) or "all"


ALL = Subset()

# Of the surfaces that can be inside an object, the parts that they consist of (ref. 1).
SURFACES = {
    "hands": (*RIGHT_HAND_PARTS, *LEFT_HAND_PARTS),
    "head": HEAD_PARTS,
    "body": tuple(sorted({*PARTS.values()} - {*RIGHT_HAND_PARTS, *LEFT_HAND_PARTS, *HEAD_PARTS})),
}
# Poses a surface in chosen frames (N,): (N, V, 3) metres, in the object's frame.
Posed = Callable[[np.ndarray], Tensor]


class Solid:
    """An object in its own frame, which says how deep points are inside it.

    Args:
        mesh: metres.
    """

    def __init__(self, mesh: Mesh):
        self._query = MeshQuery(mesh)
        self._low, self._high = torch.tensor(mesh.vertices.min(0)), torch.tensor(mesh.vertices.max(0))

    def depths(self, points: Tensor) -> Tensor:
        """(N,) metres that points (N, 3) are inside; 0 outside."""
        depths = points.new_zeros(len(points))
        # What is outside the box is outside of the solid, and most of a body is.
        near = ((points >= self._low) & (points <= self._high)).all(1).nonzero()[:, 0]
        depths[near] = (-self._query.signed_distance(points[near])).clamp_min(0)
        return depths


@dataclass(frozen=True, eq=False)
class Frames:
    """T frames of a sequence.

    Attributes:
        name: of the sequence.
        group: what it counts under.
        object: (T, V of the object) uint8, the part that touches each vertex, 0 for none (ref. 1).
        body: (T, V of the body) uint8, the own part of each touching vertex, 0 for the others.
        lift: (T,) metres that the object is above or below its first place; infinite where it is not recorded.
        surfaces: of "hands" the right one, and the left one where there is one; "head" and "body" where they are
            recorded; none but the hands' touch in generated grasps.
        solid: the object, made on demand.
        hand_length: metres, the longest side of the subject's right hand at rest.
    """

    name: str
    group: Group
    object: np.ndarray
    body: np.ndarray
    lift: np.ndarray
    surfaces: Mapping[str, Sequence[Posed]]
    solid: Callable[[], Solid]
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

    def depths(self, surface: str, frames: np.ndarray) -> Iterator[np.ndarray]:
        """Of each of chosen frames, metres that the vertices of a surface which are inside the object are inside."""
        for start in range(0, len(frames), _BATCH):
            chosen = frames[start : start + _BATCH]
            vertices = torch.cat([posed(chosen) for posed in self.surfaces[surface]], 1)
            depths = self.solid().depths(vertices.reshape(-1, 3)).reshape(len(chosen), -1).numpy()
            yield from (frame[frame > 0] for frame in depths)


WHO = {"right hand": RIGHT_HAND_PARTS, "left hand": LEFT_HAND_PARTS, "head": HEAD_PARTS}
# Parts of the right hand, thumb to pinky, then the palm, in the order of the paper (3.5).
FINGER_PARTS = {finger: RIGHT_FINGER_PARTS[finger] for finger in ("thumb", "index", "middle", "ring", "pinky")} | {
    "palm": RIGHT_HAND_PARTS[:1]
}
