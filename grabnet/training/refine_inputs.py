"""What RefineNet may learn from besides noise: the guesses of a trained CoarseNet (ref. 7)."""

from __future__ import annotations

import torch

from grabnet.body.hand import HandParameters
from grabnet.data.batches import GraspBatch
from grabnet.errors import UserError
from grabnet.models.weights import load_coarsenet, weights_file


class CoarseNetGuesses:
    """A trained CoarseNet's reconstructions of a batch, each from a sample of its posterior.

    Args:
        coarsenet: run folder or weights file.
        spread: times the posterior's deviation; above 1 the guesses are as rough as those for new objects.
    """

    def __init__(self, coarsenet: str, spread: float = 1.0):
        try:
            self.file, self.spread = weights_file(coarsenet), spread
            self.network = load_coarsenet(self.file)
        except UserError as error:  # the path may be a config's default
            raise UserError(f"model.source.coarsenet=<run folder or weights file>: {error}") from None

    @torch.no_grad()
    def __call__(self, batch: GraspBatch) -> HandParameters:
        """Hands (B), from torch's global generator."""
        network = self.network.to(batch.rotations.device)
        features = batch.features(network.bps)
        posterior = network.encode(features, batch.hand.global_orient, batch.hand.transl)
        latent = posterior.mean + self.spread * posterior.stddev * torch.randn_like(posterior.mean)
        return network.decode(latent, features)
