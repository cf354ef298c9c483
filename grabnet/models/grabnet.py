"""GrabNet: a grasp by CoarseNet, refined by RefineNet (paper 4)."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from grabnet.body.hand import HandParameters
from grabnet.geometry.conventions import Conventions
from grabnet.geometry.placed import PlacedObjects
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.generator import GraspGenerator
from grabnet.models.refinenet import RefineNet


class GrabNet(GraspGenerator):
    """Both networks as one generator; without RefineNet the coarse grasp is the grasp.

    Args:
        coarsenet: makes a grasp from a latent code.
        refinenet: corrects it; None to leave it as it is.

    Raises:
        UserError: networks that were trained on objects about different centres.
    """

    def __init__(self, coarsenet: CoarseNet, refinenet: RefineNet | None = None):
        super().__init__()
        self.coarsenet, self.refinenet = coarsenet, refinenet
        if refinenet is not None:
            remedy = "name a CoarseNet and a RefineNet that were trained alike"
            refinenet.conventions.check_shown("RefineNet", self.conventions, RefineNet.sees, remedy)

    @property
    def conventions(self) -> Conventions:
        """CoarseNet's, with RefineNet's kind of distance."""
        known = self.coarsenet.conventions
        if self.refinenet is None:
            return known
        refining = self.refinenet.conventions
        known = replace(known, distance_to=refining.distance_to, object_points=refining.object_points)
        return known if known.basis_to == "samples" else replace(known, points_in_use=refining.points_in_use)

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
