"""What RefineNet starts from in training: hands near the true ones (ref. 7); the config group `source`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import torch
from torch import Tensor

from grabnet.body.hand import HandParameters
from grabnet.data.batches import GraspBatch
from grabnet.errors import UserError
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.models.weights import load_network, weights_file
from grabnet.precision import full_precision


class RefineInput(ABC):
    """Makes a batch's inputs.

    Attributes:
        trained_from: weights files of the trained networks that it uses, by kind.
    """

    trained_from: Mapping[str, Path] = MappingProxyType({})

    @abstractmethod
    def __call__(self, batch: GraspBatch) -> HandParameters:
        """Hands (B) near the batch's true ones; random numbers from torch's global generator."""


class PoseNoise(RefineInput):
    """Independent Gaussian noise on finger joints, wrist rotation and translation (paper S.9.1).

    Args:
        finger: standard deviation per axis of a rotation vector composed with each finger joint's rotation, radians.
        wrist: the same of the wrist.
        transl: standard deviation per coordinate, metres.
    """

    def __init__(self, finger: float, wrist: float, transl: float):
        self.finger, self.wrist, self.transl = finger, wrist, transl

    @full_precision
    def __call__(self, batch: GraspBatch) -> HandParameters:
        hand = batch.hand
        return HandParameters(
            hand.global_orient @ _random_turn(hand.global_orient, self.wrist),
            hand.hand_pose @ _random_turn(hand.hand_pose, self.finger),
            hand.transl + self.transl * torch.randn_like(hand.transl),
        )


class StoredNoise(RefineInput):
    """The noisy hands that a store holds beside the true ones, as the published data do."""

    def __call__(self, batch: GraspBatch) -> HandParameters:
        """A batch's noisy hands.

        Raises:
            UserError: the store holds none.
        """
        if batch.noisy is None:
            raise UserError(
                "The frames store holds no noisy hands to start from: use data=grabnet_release "
                "data.source.noisy=true, or source=noise."
            )
        return batch.noisy


class CoarseNetGuesses(RefineInput):
    """A trained CoarseNet's reconstructions of a batch, each from a sample of its posterior.

    Args:
        coarsenet: run folder or weights file.
        spread: times the posterior's deviation; above 1 the guesses are as rough as those for new objects.
    """

    def __init__(self, coarsenet: str, spread: float = 1.0):
        try:
            file = weights_file(coarsenet)
            self.network = load_network(file, kind="CoarseNet")
        except UserError as error:  # the path may be a config's default
            raise UserError(f"source: its coarsenet must be a run folder or weights file: {error}") from None
        self.trained_from = {"CoarseNet": file}
        self.spread = spread

    @torch.no_grad()
    def __call__(self, batch: GraspBatch) -> HandParameters:
        """Hands (B), from torch's global generator."""
        network = self.network.to(batch.rest.device)
        features = network.features(batch.objects)
        posterior = network.encode(features, batch.hand.global_orient, batch.hand.transl)
        latent = posterior.mean + self.spread * posterior.stddev * torch.randn_like(posterior.mean)
        return network.decode(latent, features)


def _random_turn(rotations: Tensor, deviation: float) -> Tensor:
    return axis_angle_to_matrix(deviation * torch.randn_like(rotations[..., 0]))
