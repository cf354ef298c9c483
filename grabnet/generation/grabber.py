"""Grabber: grasps of any mesh from a trained generator."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel, HandParameters
from grabnet.cli.checks import Batch, Betas, Count, Distance, Positive, Seed, in_range, one_of
from grabnet.contact.contacts import CONTACT_DISTANCE, Contacts
from grabnet.errors import UserError
from grabnet.generation.grasps import Grasps
from grabnet.generation.placement import Placement
from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.object_mesh import load_object
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.rotations import about_z, quaternion_to_matrix
from grabnet.geometry.sdf_grid import AtlasConfig, SDFGrid
from grabnet.models.generator import GraspGenerator
from grabnet.models.trained import find_model, load_model
from grabnet.precision import single_by_default

SIDES = ("right", "left")
ORIENTATIONS = ("upright", "fixed", "random")
# Vertices that the atlas puts farther than this (metres) outside are not measured exactly: neither contact nor
# penetration can depend on them, and they are most of the hand.
_EXACT_WITHIN = 0.01
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


class Grabber(nn.Module):
    """Grasps of meshes by a generator of right hands, which sees the objects as in its training (its `conventions`).

    Args:
        generator: trained.
        hand: right hand model, the one the generator was trained with.
        batch_size: hands posed at once. The last batch is filled up, so that no result depends on how many are made.
        n_turns: ways the object is turned before the hand; grasps take them in rotation. Each costs an encoding of the
            object, which takes longer than the grasp itself.

    Attributes:
        weights: files of the generator's networks, by kind, where it was loaded from files.
    """

    @single_by_default
    def __init__(self, generator: GraspGenerator, hand: HandModel, batch_size: Batch = 256, n_turns: Batch = 128):
        super().__init__()
        self.generator, self.hand = generator.eval(), hand
        self.batch_size = batch_size
        self.n_turns = n_turns
        in_range(self)
        self.weights: dict[str, Path] = {}
        self.register_buffer("finger", Anatomy.of(hand).finger, persistent=False)

    @classmethod
    @single_by_default
    def from_pretrained(
        cls,
        name: str | Path | Sequence[str | Path] = "open",
        hand: HandModel | None = None,
        refine: bool = True,
        runs: str | Path = "runs",
        **options: int,
    ) -> Grabber:
        """A trained generator.

        Args:
            name: "open", the shipped one, trained on the open data; "newest", the newest below `runs`; a weights file,
                a run folder, or a folder with run folders `coarsenet` and `refinenet` such as `runs/demo`; or a list of
                these, a network each.
            hand: the right hand it was trained with; the open hand when omitted.
            refine: False leaves RefineNet out.
            runs: folder that is searched for "newest".
            options: further arguments of the constructor.

        Raises:
            UserError: no such networks, or trained with another hand.
        """
        hand = hand or HandModel.open()
        files = find_model(name, runs)
        grabber = cls(load_model(files, hand, refine), hand, **options)
        grabber.weights = {kind: file for kind, file in files.items() if refine or kind != "RefineNet"}
        return grabber

    @torch.no_grad()
    @single_by_default
    def forward(
        self,
        mesh: Mesh | str | Path,
        n: Count = 20,
        seed: Seed = 0,
        side: str = "right",
        orientation: str = "upright",
        betas: Tensor | Betas | None = None,
        *,
        scale: Positive = 1.0,
        up: str | None = None,
        max_size: Positive = 0.4,
        min_size: Positive = 0.01,
        to_object: np.ndarray | None = None,
        contact_distance: Distance = CONTACT_DISTANCE,
        cache_dir: str | Path | None = None,
    ) -> Grasps:
        """Sample n grasps of a mesh.

        Args:
            mesh: the object, open or closed, or a file of one.
            n: number of grasps.
            seed: grasp i of a seed is the same for every n.
            side: "left" grasps the mirrored object with the right-hand networks and mirrors the result back.
            orientation: how the object stands before the hand: "upright", turned about its vertical from grasp to
                grasp, in golden angles from a random one; "fixed", as in its file; "random", turned anyhow.
            betas: (n_betas,) shape of the hand; its mean when omitted.
            scale: metres per unit of the mesh; this and the next four as in `load_object`.
            up: axis of the mesh that points up.
            max_size: metres, of the longest side at most.
            min_size: metres, of the longest side at least.
            to_object: (4, 4) from the mesh's frame and units to metres, z up, in place of scale and up.
            contact_distance: metres, below which a vertex of the hand touches (paper 3.3).
            cache_dir: of the signed-distance grid, as in `SDFGrid.load_or_build`.

        Raises:
            UserError: an unreadable file, an object of a size that no hand takes, or an option out of range.
        """
        device = self.finger.device
        asked = SimpleNamespace(n=n, seed=seed, side=side, orientation=orientation, contact_distance=contact_distance)
        asked.betas = betas.tolist() if isinstance(betas, Tensor) else betas
        in_range(asked, of=Grabber.forward)
        one_of(asked, side=SIDES, orientation=ORIENTATIONS)
        placed = load_object(mesh, scale, up, max_size, min_size, to_object)
        betas = self._betas(betas)
        rest = self.hand.shaped(betas)
        known, turns = self.generator.conventions, _turns(orientation, min(n, self.n_turns), seed).to(device)
        placement = Placement.of(placed, turns, side, known)
        grid = SDFGrid.load_or_build(placed.solid, cache_dir, AtlasConfig(centre=known.centre))
        atlas = SDFAtlas([grid]).to(device)
        drawn = self._drawn(atlas, placement, n, seed, rest)
        _measure(MeshQuery(placed.solid, device), drawn.in_object_frame, drawn.distances)
        contacts = Contacts(
            distances=drawn.distances.cpu(), finger=self.finger.cpu(), contact_distance=contact_distance
        )
        return Grasps(
            mesh=placed.mesh,
            to_object=placed.to_object,
            side=side,
            seed=seed,
            parameters=HandParameters(*(x.cpu() for x in drawn.parameters)),
            betas=betas.expand(n, -1).cpu(),
            object_transform=drawn.transforms.cpu(),
            vertices=(drawn.vertices / placement.scale).cpu(),
            faces=(self.hand.faces if side == "right" else self.hand.faces.flip(1)).cpu(),
            contacts=contacts,
        )

    def _betas(self, betas: Tensor | Sequence[float] | None) -> Tensor:
        most = self.hand.shapedirs.shape[-1]
        if betas is None:
            return self.hand.shapedirs.new_zeros(most)
        betas = torch.as_tensor(betas, dtype=self.hand.shapedirs.dtype, device=self.hand.shapedirs.device)
        if betas.dim() != 1 or len(betas) > most:
            raise UserError(f"betas has {betas.numel()} values; this hand model has {most}.")
        return betas

    def _drawn(self, atlas: SDFAtlas, placement: Placement, n: int, seed: int, rest: Tensor) -> _Drawn:
        """n hands. All is computed in full batches: sums of products of fewer rows may round differently."""
        n_filled = -(-n // self.batch_size) * self.batch_size
        noise = _noise(n_filled, self.generator.noise_dim, seed).to(rest.device)
        objects = placement.objects(atlas)
        codes = self.generator.encode(objects)
        batches = []
        for z, ways in zip(noise.split(self.batch_size), placement.ways(n_filled).split(self.batch_size), strict=True):
            chosen = objects.select(ways)
            hands = self.generator.sample(codes[ways], chosen, z, rest)
            distances = chosen.signed_distances(self.hand(hands, rest).vertices)
            parameters, vertices = placement.hands_to_mesh(hands, ways, self.hand, rest)
            in_object_frame = placement.to_object_frame(vertices)
            batches.append((*parameters, vertices, in_object_frame, distances, placement.transforms(ways)))
        *parameters, vertices, in_object_frame, distances, transforms = (
            torch.cat(parts)[:n] for parts in zip(*batches, strict=True)
        )
        return _Drawn(HandParameters(*parameters), vertices, in_object_frame, distances, transforms)


class _Drawn(NamedTuple):
    """N hands: parameters and vertices (N, V, 3) as `Placement.hands_to_mesh` gives them, the vertices in the object
    frame, their distances (N, V) to the object by the atlas, and transforms (N, 4, 4) from mesh to world."""

    parameters: HandParameters
    vertices: Tensor
    in_object_frame: Tensor
    distances: Tensor
    transforms: Tensor


def _measure(query: MeshQuery, vertices: Tensor, distances: Tensor) -> None:
    """Replace the atlas's distances (N, V) of vertices (N, V, 3) by exact ones, wherever they are near the surface."""
    near = distances < _EXACT_WITHIN
    distances[near] = query.signed_distance(vertices[near])


def _noise(n: int, dim: int, seed: int) -> Tensor:
    """(n, dim) standard normal; row i depends on the seed and i alone."""
    return torch.from_numpy(np.random.default_rng([seed, 0]).standard_normal((n, dim), np.float32))


def _turns(orientation: str, n: int, seed: int) -> Tensor:
    """(up to n, 3, 3) rotations of the object; row i depends on the seed and i alone."""
    rng = np.random.default_rng([seed, 1])
    if orientation == "upright":
        # Golden angles: however few of them are used, they are spread around evenly.
        return about_z(torch.from_numpy(rng.uniform(0, 2 * np.pi) + np.arange(n) * _GOLDEN_ANGLE).float())
    if orientation == "fixed":
        return torch.eye(3).unsqueeze(0)
    return quaternion_to_matrix(torch.from_numpy(rng.standard_normal((n, 4), np.float32)))
