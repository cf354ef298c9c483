"""How objects are shown to a network: what it was trained with, which every use of it must repeat."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from grabnet.cli.checks import Count, in_range, one_of
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.nearest import BLOCK, by_neighbourhood

CENTRES = ("mean_vertex", "surface", "box")
# What distances are measured to.
SHAPES = ("surface", "samples")
# What a network may see of an object: where it stands, distances of the hand, a basis point set.
ASPECTS = ("centre", "distances", "basis")


@dataclass(frozen=True)
class Conventions:
    """What a network was trained with. The defaults are those of weights that say nothing of it.

    Attributes: all but `hand` called as the settings of `data` in a config that decide them.
        centre: point of an object at the origin of the world: "mean_vertex" of its mesh, mean of its "surface" by area,
            or the middle of its bounding "box" (published, ref. 6).
        distance_to: distances of hand vertices are signed, to the "surface"; or unsigned, to the nearest of "samples"
            (published, ref. 6): surface points in training, vertices in use (`vertices_in_use`).
        basis_to: basis point sets hold unsigned distances to the "surface"; or to the nearest of "samples" (published,
            ref. 6), which are `vertices_in_use`, in training, too.
        object_points: surface points of an object in training (published: 2048).
        points_in_use: vertices of an object in use (published: 10,000).
        rotate: whether training frames were rotated about the vertical at random.
        hand: `HandModel.fingerprint` of the hand; None where it is not known.

    Raises:
        UserError: a word or number that is none of these.
    """

    centre: str = "mean_vertex"
    distance_to: str = "surface"
    basis_to: str = "surface"
    object_points: Count = 2048
    points_in_use: Count = 10_000
    rotate: bool = True
    hand: str | None = None

    def __post_init__(self):
        one_of(self, "data.", centre=CENTRES, distance_to=SHAPES, basis_to=SHAPES, rotate=(True, False))
        in_range(self, "data.")

    def shown(self, aspects: tuple[str, ...] = ASPECTS) -> dict[str, str | int]:
        """Settings that decide these aspects of what a network sees of an object, by name."""
        values: dict[str, str | int] = {}
        if "centre" in aspects:
            values["centre"] = self.centre
        if "distances" in aspects:
            values["distance_to"] = self.distance_to
            if self.distance_to == "samples":
                values |= {"object_points": self.object_points, "points_in_use": self.points_in_use}
        if "basis" in aspects:
            values["basis_to"] = self.basis_to
            if self.basis_to == "samples":
                values["points_in_use"] = self.points_in_use
        return values

    def check_shown(self, name: str, other: Conventions, aspects: tuple[str, ...], remedy: str) -> None:
        """Raise a `UserError` where a network trained with these conventions would be shown objects by others.

        Args:
            name: of the network, for the sentence.
            other: those it would be shown by.
            aspects: what it sees.
            remedy: ends the sentence.
        """
        trained, given = self.shown(aspects), other.shown(aspects)
        if trained != given:
            raise UserError(
                f"{name} was trained with {_as_options(trained)}, and would be shown objects with "
                f"{_as_options(given)}: {remedy}."
            )

    @property
    def in_use(self) -> Conventions:
        """Those by which meshes from anywhere are shown.

        Training meshes have faces of about one size, so that their mean vertex is about the mean of the surface; a
        user's mesh may have most of its vertices in one corner, and is centred at its surface.
        """
        return replace(self, centre="surface") if self.centre == "mean_vertex" else self

    def centre_of(self, mesh: Mesh) -> np.ndarray:
        """(3,) float32, the point of a mesh, in its own frame, that lies at the origin of the world."""
        if self.centre == "box":
            return mesh.bounds.mean(0, dtype=np.float32)
        return mesh.centroid if self.centre == "mean_vertex" else mesh.surface_centre

    def vertices_in_use(self, mesh: Mesh) -> Tensor:
        """(points_in_use, 3) points about the centre of a mesh, in metres.

        The mesh is subdivided (`Mesh.subdivided`) until it has as many vertices; those of the first numbers in
        `numpy.random.default_rng(0).permutation` of their number are taken, neighbours one after the other.
        """
        centre = self.centre_of(mesh)
        while len(mesh.vertices) < self.points_in_use:
            mesh = mesh.subdivided()
        chosen = np.random.default_rng(0).permutation(len(mesh.vertices))[: self.points_in_use]
        points = torch.from_numpy(mesh.vertices[chosen] - centre)
        return points[by_neighbourhood(points, BLOCK)]


def _as_options(settings: dict[str, str | int]) -> str:
    return " ".join(f"data.{name}={value}" for name, value in settings.items())
