"""What RefineNet learns to correct: noisy versions of true grasps (paper S.9.2, ref. 7)."""

from __future__ import annotations

import torch

from grabnet.body.hand import HandParameters
from grabnet.data.batches import GraspBatch
from grabnet.errors import UserError
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.precision import full_precision


class PoseNoise:
    """Independent Gaussian noise on finger joints, wrist rotation and translation.

    Args:
        finger, wrist: standard deviation per axis of a rotation vector composed with the joint's rotation, radians.
        transl: standard deviation per coordinate, metres.
    """

    def __init__(self, finger: float, wrist: float, transl: float):
        self.finger, self.wrist, self.transl = finger, wrist, transl

    @full_precision
    def __call__(self, batch: GraspBatch) -> HandParameters:
        """A noisy copy of a batch's hands, from torch's global generator."""
        hand = batch.hand
        return HandParameters(
            hand.global_orient @ _random_turn(hand.global_orient, self.wrist),
            hand.hand_pose @ _random_turn(hand.hand_pose, self.finger),
            hand.transl + self.transl * torch.randn_like(hand.transl),
        )


class StoredNoise:
    """The noisy hands that a store holds beside the true ones, as the published data do."""

    def __call__(self, batch: GraspBatch) -> HandParameters:
        """A batch's noisy hands.

        Raises:
            UserError: the store holds none.
        """
        if batch.noisy is None:
            raise UserError(
                "The frames store holds no noisy hands to start from: use data=grabnet_release "
                "data.prepare.noisy=true, or source=noise."
            )
        return batch.noisy


def _random_turn(rotations: torch.Tensor, deviation: float) -> torch.Tensor:
    return axis_angle_to_matrix(deviation * torch.randn_like(rotations[..., 0]))
