"""What RefineNet starts from in training, and what it is to reach (ref. 7); the config group `source`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import torch
from torch import Tensor

from grabnet.body.hand import HandModel, HandParameters
from grabnet.cli.checks import Weight
from grabnet.data.batches import GraspBatch
from grabnet.errors import UserError
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.weights import load_network, weights_file
from grabnet.precision import full_precision


class RefineInput(ABC):
    """Makes RefineNet's task of a batch.

    Attributes:
        trained_from: weights files of the trained networks that it uses, by kind.
    """

    trained_from: Mapping[str, Path] = MappingProxyType({})

    @abstractmethod
    def __call__(self, batch: GraspBatch, model: HandModel) -> GraspBatch:
        """The batch with the hands to start from as `noisy`, and with the hands to reach as the true ones.

        Args:
            batch: of recorded hands.
            model: the hand model, which poses them.

        Random numbers are those of torch's global generator.
        """


class RecordedPerturbed(RefineInput):
    """Recorded hands, perturbed, are to come back (paper S.9.1).

    Args:
        finger: standard deviation per axis of a rotation vector composed with each finger joint's rotation, radians.
        wrist: the same of the wrist.
        transl: standard deviation per coordinate, metres.
    """

    def __init__(self, finger: Weight, wrist: Weight, transl: Weight):
        self.finger, self.wrist, self.transl = finger, wrist, transl

    def __call__(self, batch: GraspBatch, model: HandModel) -> GraspBatch:
        return replace(batch, noisy=perturbed(batch.hand, self.finger, self.wrist, self.transl))


class StoredNoise(RefineInput):
    """The noisy hands that a store holds beside the recorded ones, as the published data do, are to become those."""

    def __call__(self, batch: GraspBatch, model: HandModel) -> GraspBatch:
        """The batch as it is.

        Raises:
            UserError: the store holds no noisy hands.
        """
        if batch.noisy is None:
            raise UserError(
                "The frames store holds no noisy hands to start from: use data=grabnet_release "
                "data.source.noisy=true, or source=recorded_perturbed."
            )
        return batch


class SamplesPerturbed(RefineInput):
    """Grasps sampled from a trained CoarseNet take the recorded ones' place: perturbed, they are to return (paper 4).

    Args:
        coarsenet: run folder or weights file.
        finger: as in `RecordedPerturbed`.
        wrist: likewise.
        transl: likewise.
    """

    def __init__(self, coarsenet: str, finger: Weight, wrist: Weight, transl: Weight):
        self.network, self.trained_from = _trained(coarsenet)
        self.finger, self.wrist, self.transl = finger, wrist, transl

    @torch.no_grad()
    def __call__(self, batch: GraspBatch, model: HandModel) -> GraspBatch:
        network = self.network.to(batch.rest.device)
        latent = torch.randn(len(batch), network.latent_dim, device=batch.rest.device)
        sampled = network.decode(latent, network.features(batch.objects))
        noisy = perturbed(sampled, self.finger, self.wrist, self.transl)
        return replace(batch.with_hands(model, sampled, batch.rest), noisy=noisy)


class CoarseNetGuesses(RefineInput):
    """A trained CoarseNet's reconstructions, each from a sample of its posterior, are to become the recorded hands.

    Args:
        coarsenet: run folder or weights file.
        spread: times the posterior's deviation; above 1 the guesses are as rough as those for new objects.
    """

    def __init__(self, coarsenet: str, spread: Weight = 1.0):
        self.network, self.trained_from = _trained(coarsenet)
        self.spread = spread

    @torch.no_grad()
    def __call__(self, batch: GraspBatch, model: HandModel) -> GraspBatch:
        network = self.network.to(batch.rest.device)
        features = network.features(batch.objects)
        posterior = network.encode(features, batch.hand.global_orient, batch.hand.transl)
        latent = posterior.mean + self.spread * posterior.stddev * torch.randn_like(posterior.mean)
        return replace(batch, noisy=network.decode(latent, features))


@full_precision
def perturbed(hand: HandParameters, finger: float, wrist: float, transl: float) -> HandParameters:
    """Hands with independent Gaussian noise on finger joints, wrist and translation, as in `RecordedPerturbed`."""
    return HandParameters(
        hand.global_orient @ _random_turn(hand.global_orient, wrist),
        hand.hand_pose @ _random_turn(hand.hand_pose, finger),
        hand.transl + transl * torch.randn_like(hand.transl),
    )


def _trained(coarsenet: str) -> tuple[CoarseNet, dict[str, Path]]:
    """The network of a run folder or weights file, and that file by its kind."""
    try:
        file = weights_file(coarsenet)
        return load_network(file, kind="CoarseNet"), {"CoarseNet": file}
    except UserError as error:  # the path may be a config's default
        raise UserError(f"source: its coarsenet must be a run folder or weights file: {error}") from None


def _random_turn(rotations: Tensor, deviation: float) -> Tensor:
    return axis_angle_to_matrix(deviation * torch.randn_like(rotations[..., 0]))
