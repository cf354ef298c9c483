"""GrabNet: a grasp by CoarseNet, refined by RefineNet (paper 4)."""

from __future__ import annotations

from torch import Tensor

from grabnet.body.hand import HandParameters
from grabnet.geometry.placed import PlacedObjects
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.generator import GraspGenerator
from grabnet.models.refinenet import RefineNet


class GrabNet(GraspGenerator):
    """Both networks as one generator; without RefineNet the coarse grasp is the grasp.

    Args:
        coarsenet: makes a grasp from a latent code.
        refinenet: corrects it; None to leave it as it is.
    """

    def __init__(self, coarsenet: CoarseNet, refinenet: RefineNet | None = None):
        super().__init__()
        self.coarsenet, self.refinenet = coarsenet, refinenet

    @property
    def noise_dim(self) -> int:
        return self.coarsenet.latent_dim

    def encode(self, objects: PlacedObjects) -> Tensor:
        return self.coarsenet.features(objects)

    def sample(self, code: Tensor, objects: PlacedObjects, noise: Tensor, rest: Tensor) -> HandParameters:
        hands = self.coarsenet.decode(noise, code)
        return hands if self.refinenet is None else self.refinenet(hands, objects.distances, rest)

    def variants(self) -> dict[str, GraspGenerator]:
        coarse = {"CoarseNet": GrabNet(self.coarsenet)}
        return coarse if self.refinenet is None else coarse | {"CoarseNet + RefineNet": self}
