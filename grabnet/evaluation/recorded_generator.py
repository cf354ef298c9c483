"""A generator without a network: recorded grasps of one object, put about another."""

from __future__ import annotations

import torch
from torch import Tensor

from grabnet.body.hand import HandModel, HandParameters
from grabnet.data.frames import FramesStore
from grabnet.geometry.conventions import Conventions
from grabnet.geometry.placed import PlacedObjects
from grabnet.geometry.rotations import about_z, axis_angle_to_matrix
from grabnet.models.generator import GraspGenerator


class RecordedGenerator(GraspGenerator):
    """Draws recorded grasps of one object at random, with replacement, and puts them about another one's centroid.

    The recorded posture and place of the wrist are kept; the shape of the hand is the one that is asked for. Only for
    right hands: of a mirrored object there is no recording.

    Args:
        store: of the frames.
        hand: the model that the store was made with.
        name: of the object that was grasped.
        turn: about the vertical, radians, that makes the other object look most like it.
    """

    noise_dim = 1
    conventions = Conventions()  # objects stand about their centroid, as in the store

    def __init__(self, store: FramesStore, hand: HandModel, name: str, turn: float):
        super().__init__()
        frames = store.frames.select(store.frames.object == store.objects.index(name))
        recorded = frames.hand()
        back = about_z(torch.tensor(turn)).mT @ axis_angle_to_matrix(frames.object_orient).mT
        wrist = (hand.J_regressor[0] @ store.v_template)[frames.subject] + recorded.transl
        self.register_buffer("global_orient", back @ recorded.global_orient, False)
        self.register_buffer("hand_pose", recorded.hand_pose, False)
        self.register_buffer("wrist", (back @ wrist.unsqueeze(-1)).squeeze(-1), False)
        self.register_buffer("joint_regressor", hand.J_regressor[0], False)

    def encode(self, objects: PlacedObjects) -> Tensor:
        return self.wrist.new_zeros(len(objects), 0)

    def sample(self, code: Tensor, objects: PlacedObjects, noise: Tensor, rest: Tensor) -> HandParameters:
        share = torch.special.ndtr(noise[:, 0].double())  # uniform in 0 … 1
        row = (share * len(self.wrist)).long().clamp(max=len(self.wrist) - 1)
        world = objects.rotations
        wrist = (world @ self.wrist[row].unsqueeze(-1)).squeeze(-1)
        return HandParameters(world @ self.global_orient[row], self.hand_pose[row], wrist - self.joint_regressor @ rest)
