"""Hands as they are evaluated: meshes about an object, whatever method made them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.body.skeleton import LEFT_HAND_PARTS, RIGHT_HAND_PARTS
from grabnet.contact.bones import Bones
from grabnet.geometry.openings import close
from grabnet.io.files import sha256


@dataclass(frozen=True, eq=False, kw_only=True)
class Hands:
    """N hands of one topology in the frame of an object's mesh, metres.

    Attributes:
        vertices: (N, V, 3) float32.
        faces: (F, 3) int64; open at the wrist or closed.
        hand_pose: (N, 15, 3, 3) joint rotations, where they are known.
        sequences: (N,) int64, which recording each is from; None where they were not recorded.
    """

    vertices: np.ndarray
    faces: np.ndarray
    hand_pose: np.ndarray | None = None
    sequences: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.vertices)

    @cached_property
    def keys(self) -> list[str]:
        """A hash of each grasp: equal for equal content."""
        shared = sha256(self.faces)
        return [
            sha256(shared, *(values[i] for name in self._per_grasp() if (values := getattr(self, name)) is not None))
            for i in range(len(self))
        ]

    @cached_property
    def key(self) -> str:
        """Of all together."""
        return sha256(*self.keys)

    @cached_property
    def closed(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (N, V + openings, 3) and faces of the same hands, watertight at the wrist."""
        return close(self.vertices, self.faces)

    def select(self, index: np.ndarray | slice) -> Hands:
        """Return the chosen ones."""
        chosen = {name: getattr(self, name) for name in self._per_grasp()}
        return Hands(faces=self.faces, **{k: None if v is None else v[index] for k, v in chosen.items()})

    def _per_grasp(self) -> list[str]:
        return [f.name for f in fields(self) if f.name != "faces"]


@dataclass(frozen=True, eq=False)
class HandLabels:
    """What the vertices of a hand model are, for meshes that have its vertices; made by `HandLabels.of`.

    Attributes:
        finger: (V,) index into `FINGERS`; -1 on palm and wrist.
        parts: (V,) uint8, GRAB's number of each vertex's part.
        anatomy: joint axes and limits.
        joint_regressor: (16, V).
        bones: that follow the vertices.
    """

    finger: np.ndarray
    parts: np.ndarray
    anatomy: Anatomy
    joint_regressor: Tensor
    bones: Bones

    @classmethod
    def of(cls, hand: HandModel) -> HandLabels:
        anatomy = Anatomy.of(hand)
        labels = RIGHT_HAND_PARTS if hand.is_right else LEFT_HAND_PARTS
        parts = np.array(labels, np.uint8)[anatomy.bone.numpy()]
        bones = Bones.of(hand, hand.v_template.numpy(), labels)
        return cls(anatomy.finger.numpy(), parts, anatomy, hand.J_regressor, bones)

    def fit(self, hands: Hands) -> bool:
        """Whether the hands have this model's vertices."""
        return hands.vertices.shape[1] == len(self.finger)

    def parts_of(self, hands: Hands) -> np.ndarray:
        """(V,) uint8: the part of each vertex; the whole hand where its vertices are not this model's."""
        return self.parts if self.fit(hands) else np.full(hands.vertices.shape[1], RIGHT_HAND_PARTS[0], np.uint8)

    def keypoints(self, hands: Hands) -> np.ndarray | None:
        """(N, 21, 3) float64 metres: 16 joints, regressed from the vertices, and the fingertips in the order of
        `FINGERS`, in the hand's own frame: the wrist at the origin, the knuckle of the middle finger along x, the
        knuckles of index and pinky in a plane that contains x. None for hands of other vertices."""
        if not self.fit(hands):
            return None
        vertices = torch.as_tensor(hands.vertices).double()
        points = torch.cat([self.joint_regressor.double() @ vertices, vertices[:, self.anatomy.tips]], 1)
        points = points - points[:, :1]
        x, z = points[:, 4], torch.linalg.cross(points[:, 1], points[:, 7])  # middle; index and pinky
        y = torch.linalg.cross(z, x)
        frame = torch.stack([x, y, torch.linalg.cross(x, y)], -1)
        return (points @ (frame / frame.norm(dim=1, keepdim=True))).numpy()
