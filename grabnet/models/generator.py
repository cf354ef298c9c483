"""What the code around a model knows of it: how it is saved, and how it makes grasps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar, Self

from torch import Tensor, nn

from grabnet.body.hand import HandModel, HandParameters
from grabnet.geometry.conventions import ASPECTS, Conventions
from grabnet.geometry.placed import PlacedObjects


class SavedNetwork(nn.Module, ABC):
    """A network whose weights file says how to rebuild it, and what it was trained with (`grabnet.models.weights`).

    Attributes:
        sees: aspects of an object (`ASPECTS`) that it depends on.
        conventions: what it was trained with; set by its training and by whoever loads it.
    """

    sees: ClassVar[tuple[str, ...]] = ASPECTS
    conventions: Conventions = Conventions()

    @abstractmethod
    def arguments(self) -> dict[str, int | float]:
        """Numbers that the constructor needs; they go into the header of the weights file."""

    @classmethod
    def rebuild(
        cls, arguments: Mapping[str, int | float], tensors: Mapping[str, Tensor], hand: HandModel | None
    ) -> Self:
        """The network before its weights are filled in.

        Args:
            arguments: as `arguments()` gave them.
            tensors: all weights of the file, by name.
            hand: the hand model to pose, for networks that do.
        """
        return cls(**arguments)


class GraspGenerator(nn.Module, ABC):
    """Makes grasps of an object from random numbers.

    Sampling, monitoring and evaluation know no more of a model than this. A network of one piece is a `SavedNetwork`,
    too; one of several pieces, such as `GrabNet`, is loaded from several files.
    """

    noise_dim: int
    """Standard normal numbers that one grasp is made from."""

    conventions: Conventions
    """How the objects that are given to it must be shown."""

    @abstractmethod
    def encode(self, objects: PlacedObjects) -> Tensor:
        """Codes (K, C) of K placed objects. Many grasps may share a code."""

    @abstractmethod
    def sample(self, code: Tensor, objects: PlacedObjects, noise: Tensor, rest: Tensor) -> HandParameters:
        """B right hands in the world of the objects.

        Args:
            code: (B, C) of the objects, from `encode`.
            objects: B placed objects.
            noise: (B, noise_dim) standard normal; equal noise gives equal grasps.
            rest: rest vertices of the hands, (V, 3) or (B, V, 3), metres.
        """

    def variants(self) -> dict[str, GraspGenerator]:
        """Models that an evaluation compares, by name, the best one last: this one, and parts of it that also work."""
        return {type(self).__name__: self}
