"""A recording as its right hand has it, or its left hand, which a mirror turns into a right one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from grabnet.body.skeleton import MIRRORED_PART
from grabnet.data.sequences import HandTrack, RigidTrack, Sequence
from grabnet.data.sources.base import HandFrames
from grabnet.data.splits import MIRRORED_SUFFIX
from grabnet.geometry.mesh import Mesh

# The mirror is the plane x = 0. Axes of rotation are reversed by it where vectors are not.
_FLIP = np.array([-1, 1, 1], np.float32)


@dataclass(frozen=True)
class GraspTrack:
    """A right hand, an object and what touches it, frame by frame.

    Attributes:
        name: of the recording, `<subject>/<object>_<action>_<k>`.
        subject: whose hand it is.
        object_name: what it is on.
        intent: the action, GRAB's `motion_intent`.
        hand: the right hand's motion; its `vtemp` names the subject's rest hand for `RecordingSource.rest`.
        object: the object's motion.
        labels: (T, V of the object) uint8, the part that touches each vertex (ref. 1), 0 for none.
        is_mirrored: whether it is seen in a mirror: name, subject and object name then end in `MIRRORED_SUFFIX`.
    """

    name: str
    subject: str
    object_name: str
    intent: str
    hand: HandTrack
    object: RigidTrack
    labels: np.ndarray
    is_mirrored: bool = False

    @classmethod
    def right(cls, sequence: Sequence) -> GraspTrack:
        """What the right hand does."""
        return cls(
            sequence.name, sequence.sbj_id, sequence.obj_name, sequence.motion_intent, sequence.rhand, sequence.object,
            sequence.contact.object,
        )  # fmt: skip

    @classmethod
    def left_mirrored(cls, sequence: Sequence) -> GraspTrack:
        """What the left hand does, seen in a mirror that stands upright: a right hand of the mirrored subject.

        The hand's template is the left one's mirror image, and the object another one, the mirror image of the mesh.
        """
        hand, track = sequence.lhand, sequence.object
        return cls(
            sequence.name + MIRRORED_SUFFIX,
            sequence.sbj_id + MIRRORED_SUFFIX,
            sequence.obj_name + MIRRORED_SUFFIX,
            sequence.motion_intent,
            replace(
                hand,
                global_orient=-_FLIP * hand.global_orient,
                fullpose=(-_FLIP * hand.fullpose.reshape(-1, 15, 3)).reshape(-1, 45),
                transl=_FLIP * hand.transl,
            ),
            replace(track, global_orient=-_FLIP * track.global_orient, transl=_FLIP * track.transl),
            MIRRORED_PART[sequence.contact.object],
            is_mirrored=True,
        )

    def __len__(self) -> int:
        return len(self.labels)

    def frames(self, chosen: np.ndarray) -> HandFrames:
        """Hand and object in chosen frames (N,)."""
        return HandFrames(
            subject=self.subject,
            object=self.object_name,
            intent=self.intent,
            frame=torch.as_tensor(chosen),
            hand=self.hand.parameters(chosen),
            object_rotation=self.object.rotations(chosen),
            object_transl=torch.as_tensor(self.object.transl[chosen]),
        )


def mirrored(points: np.ndarray | Tensor) -> Tensor:
    """Points (..., 3) in the mirror that `GraspTrack.left_mirrored` looks into."""
    return torch.as_tensor(points, dtype=torch.float32) * torch.as_tensor(_FLIP)


def mirror_image(mesh: Mesh) -> Mesh:
    """The mesh in that mirror: its vertices in order, faces outwards."""
    return Mesh(_FLIP * mesh.vertices, mesh.faces[:, ::-1])
