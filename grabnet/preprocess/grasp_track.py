"""A recording as its right hand has it, or as its left hand has it in a mirror: then too a right hand's."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from grabnet.body.skeleton import MIRRORED_PART
from grabnet.data.sequences import HandTrack, RigidTrack, Sequence
from grabnet.data.splits import MIRRORED_SUFFIX
from grabnet.geometry.mesh import Mesh

# The mirror is the plane x = 0. Axes of rotation are reversed by it where vectors are not.
_FLIP = np.array([-1, 1, 1], np.float32)


@dataclass(frozen=True)
class GraspTrack:
    """A right hand, an object and what touches it, frame by frame.

    Attributes:
        name, subject, object_name, intent: of the recording; mirrored ones end in `MIRRORED_SUFFIX`.
        hand: the right hand's motion. object: the object's.
        labels: (T, V of the object) uint8, the part that touches each vertex, 0 for none.
    """

    name: str
    subject: str
    object_name: str
    intent: str
    hand: HandTrack
    object: RigidTrack
    labels: np.ndarray

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
        hand, thing = sequence.lhand, sequence.object
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
            replace(thing, global_orient=-_FLIP * thing.global_orient, transl=_FLIP * thing.transl),
            MIRRORED_PART[sequence.contact.object],
        )

    @property
    def is_mirrored(self) -> bool:
        return self.name.endswith(MIRRORED_SUFFIX)

    def __len__(self) -> int:
        return len(self.labels)

    def frames(self, chosen: np.ndarray, centroid: np.ndarray) -> dict[str, Tensor]:
        """Hand and object in chosen frames about the object's centroid, heading kept (ref. 3), for `write_shard`.

        Args:
            chosen: (N,) frame numbers.
            centroid: (3,) of the recorded object's mesh, in its own frame.
        """
        hand, thing = self.hand, self.object
        centroid = _FLIP * centroid if self.is_mirrored else centroid
        origin = thing.to_world(torch.as_tensor(centroid, dtype=torch.float32).view(1, 3), chosen)[:, 0]
        return {
            "global_orient": torch.as_tensor(hand.global_orient[chosen]),
            "hand_pose": torch.as_tensor(hand.fullpose[chosen]),
            "transl": torch.as_tensor(hand.transl[chosen]) - origin,
            "object_orient": -torch.as_tensor(thing.global_orient[chosen]),  # the store's acts on column vectors
            "frame": torch.as_tensor(chosen),
        }


def mirror_image(mesh: Mesh) -> Mesh:
    """The mesh in the mirror that `GraspTrack.left_mirrored` looks into: its vertices in order, faces outwards."""
    return Mesh(_FLIP * mesh.vertices, mesh.faces[:, ::-1])
