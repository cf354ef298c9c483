"""Grabber: grasps of any mesh from a trained generator."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import asdict, is_dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel, HandParameters
from grabnet.cli.checks import Amount, Batch, Betas, Count, Distance, Positive, Seed, in_range, one_of
from grabnet.cli.progress import track
from grabnet.contact.contacts import CONTACT_DISTANCE, Contacts
from grabnet.errors import UserError
from grabnet.generation.candidates import Candidates, draw
from grabnet.generation.grasps import Grasps
from grabnet.generation.placement import Placement
from grabnet.generation.ranking import Ranked, RankingConfig, choose, pool_sizes
from grabnet.generation.scoring import judge
from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.object_mesh import load_object
from grabnet.geometry.placed import PlacedObjects
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.rotations import about_z, quaternion_to_matrix
from grabnet.geometry.sdf_grid import AtlasConfig, SDFGrid
from grabnet.grasping.grasp_hand import GraspHand
from grabnet.grasping.interior import Interior
from grabnet.grasping.measures import measure_grasps
from grabnet.grasping.optimiser import GraspOptimiser, OptimiserConfig
from grabnet.models.generator import GraspGenerator
from grabnet.models.trained import find_model, load_model
from grabnet.precision import single_by_default

SIDES = ("right", "left")
ORIENTATIONS = ("upright", "fixed", "random")
# Vertices that the atlas puts farther than this (metres) outside are not measured exactly: neither contact nor
# penetration can depend on them, and they are most of the hand.
_EXACT_WITHIN = 0.01
_SETTINGS = ("batch_size", "n_turns", "optimise", "candidates", "optimiser", "ranking")
MOST_HANDS = 1_000_000
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


def check_hands(n: int, candidates: int) -> None:
    """Refuse more hands at once than memory holds.

    Raises:
        UserError: n times candidates is above `MOST_HANDS`.
    """
    if (hands := n * candidates) > MOST_HANDS:
        size = hands * 778 * 3 * 4 / 1e9  # vertices in single precision
        raise UserError(
            f"n={n} with candidates={candidates} makes {hands:,} hands, whose vertices take {size:,.1f} GB; at most "
            f"{MOST_HANDS:,} are made at once: ask for fewer."
        )


class Grabber(nn.Module):
    """Grasps of meshes by a generator of right hands, which sees the objects as in its training (its `conventions`).

    Args:
        generator: trained.
        hand: right hand model, the one the generator was trained with.
        batch_size: hands posed at once. The last batch is filled up, so that no result depends on how many are made.
        n_turns: ways the object is turned before the hand; grasps take them in rotation. Each costs an encoding of the
            object, which takes longer than drawing the grasp itself.
        optimise: iterations by which each hand is optimised against the object; 0 leaves it as it is drawn.
        candidates: hands drawn for each grasp; the best ones that differ are kept (`ranking.choose`). 1 keeps all.
        optimiser: how hands are optimised; its `iterations` give way to `optimise`.
        ranking: what makes a candidate better than another, and how they are chosen.

    Attributes:
        weights: files of the generator's networks, by kind, where it was loaded from files.
    """

    @single_by_default
    def __init__(
        self,
        generator: GraspGenerator,
        hand: HandModel,
        batch_size: Batch = 256,
        n_turns: Batch = 128,
        optimise: Amount = 60,
        candidates: Count = 4,
        optimiser: OptimiserConfig = OptimiserConfig(),  # noqa: B008, frozen
        ranking: RankingConfig = RankingConfig(),  # noqa: B008, frozen
    ):
        super().__init__()
        self.generator, self.hand = generator.eval(), hand
        self.batch_size = batch_size
        self.n_turns = n_turns
        self.optimise = optimise
        self.candidates = candidates
        in_range(self)
        self.optimiser = replace(optimiser, iterations=optimise)
        self.ranking = ranking
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

    @property
    def settings(self) -> dict[str, Any]:
        """All arguments of the constructor but generator and hand, ready for JSON; grasps depend on them."""
        values = {name: getattr(self, name) for name in _SETTINGS}
        return {name: asdict(value) if is_dataclass(value) else value for name, value in values.items()}

    def changed(self, generator: GraspGenerator | None = None, **settings: Any) -> Grabber:
        """A grabber with another generator or other settings on the same device."""
        values = {name: getattr(self, name) for name in _SETTINGS} | settings
        return Grabber(generator or self.generator, self.hand, **values).to(self.finger.device)

    @torch.inference_mode(False)  # within it nothing could be optimised
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
        table: bool = False,
        cache_dir: str | Path | None = None,
    ) -> Grasps:
        """Sample n grasps of a mesh.

        Args:
            mesh: the object, open or closed, or a file of one.
            n: number of grasps.
            seed: grasp i of a seed is the same for every n: it is chosen from as many candidates as i decides
                (`ranking.pool_sizes`).
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
            table: the object stands on a table, which hands are optimised and chosen to stay above; not with
                orientation "random".
            cache_dir: of the signed-distance grid, as in `SDFGrid.load_or_build`.

        Raises:
            UserError: an unreadable file, an object of a size that no hand takes, or an option out of range.
        """
        device = self.finger.device
        asked = SimpleNamespace(n=n, seed=seed, side=side, orientation=orientation, contact_distance=contact_distance)
        asked.betas = betas.tolist() if isinstance(betas, Tensor) else betas
        in_range(asked, of=Grabber.forward)
        one_of(asked, side=SIDES, orientation=ORIENTATIONS)
        check_hands(n, self.candidates)
        if table and orientation == "random":
            raise UserError("orientation is 'random', and table true: an object on a table is upright or fixed.")
        placed = load_object(mesh, scale, up, max_size, min_size, to_object)
        betas = self._betas(betas)
        rest = self.hand.shaped(betas)
        known, pools = self.generator.conventions.in_use, pool_sizes(n, self.candidates, self.ranking.pool)
        n_drawn = int(pools[-1]) if self.candidates > 1 else n
        turns = _turns(orientation, min(n_drawn, self.n_turns), seed).to(device)
        placement = Placement.of(placed, turns, side, known)
        grid = SDFGrid.load_or_build(placed.solid, cache_dir, AtlasConfig(centre=known.centre))
        objects = placement.objects(SDFAtlas([grid]).to(device))
        held = GraspHand(self.hand, Anatomy.of(self.hand), betas)
        floor = float(placed.solid.vertices[:, 2].min() - placement.centre[2]) if table else None
        kept, ranked = self._kept(objects, held, pools, seed, rest, contact_distance, floor)
        parameters, vertices, distances = self._to_mesh(placement, objects, kept, rest)
        in_object_frame = placement.to_object_frame(vertices)
        _measure(MeshQuery(placed.solid, device), in_object_frame, distances)
        contacts = Contacts(distances=distances.cpu(), finger=self.finger.cpu(), contact_distance=contact_distance)
        faces = (self.hand.faces if side == "right" else self.hand.faces.flip(1)).cpu()
        model = deepcopy(self.hand).cpu()
        measures = measure_grasps(
            GraspHand(model, Anatomy.of(model), betas.cpu()),
            placed.solid,
            in_object_frame.cpu(),
            faces,
            kept.hands.hand_pose.cpu(),
            contacts,
        )
        return Grasps(
            mesh=placed.mesh,
            to_object=placed.to_object,
            remarks=placed.remarks,
            side=side,
            seed=seed,
            parameters=HandParameters(*(x.cpu() for x in parameters)),
            betas=betas.expand(n, -1).cpu(),
            object_transform=placement.transforms(kept.ways).cpu(),
            vertices=(vertices / placement.scale).cpu(),
            faces=faces,
            contacts=contacts,
            measures=measures,
            ranked=ranked,
        )

    def _betas(self, betas: Tensor | Sequence[float] | None) -> Tensor:
        most = self.hand.shapedirs.shape[-1]
        if betas is None:
            return self.hand.shapedirs.new_zeros(most)
        betas = torch.as_tensor(betas, dtype=self.hand.shapedirs.dtype, device=self.hand.shapedirs.device)
        if betas.dim() != 1 or len(betas) > most:
            raise UserError(f"betas has {betas.numel()} values; this hand model has {most}.")
        return betas

    def _kept(
        self,
        objects: PlacedObjects,
        held: GraspHand,
        pools: Tensor,
        seed: int,
        rest: Tensor,
        contact_distance: float,
        floor: float | None,
    ) -> tuple[Candidates, Ranked | None]:
        """A hand of each of the pools, in the right-hand world: the best ones where there are several for each."""
        optimiser = GraspOptimiser(held, self.optimiser) if self.optimise else None
        interior = Interior.of(held) if self.candidates > 1 else None
        drawn, scores, keypoints = [], [], []
        batches = draw(self.generator, objects, int(pools[-1]), self.batch_size, seed, rest, optimiser, floor)
        for batch in track(batches, "Drawing grasps", -(-int(pools[-1]) // self.batch_size)):
            drawn.append(batch)
            if interior is not None:
                seen = objects.select(batch.ways)
                judged = judge(
                    *(held, interior, self.hand, batch.hands, rest, seen),
                    *(self.ranking, self.optimiser.forces, contact_distance, floor),
                )
                scores.append(judged.parts)
                keypoints.append(judged.keypoints)
        all_drawn = Candidates.cat(drawn)
        if self.candidates == 1:
            return all_drawn.select(slice(len(pools))), None
        parts = {name: torch.cat([score[name] for score in scores]).cpu() for name in scores[0]}
        kept = choose(sum(parts.values()), torch.cat(keypoints).cpu(), pools, self.ranking)
        ranked = Ranked(kept, {name: values[kept.index] for name, values in parts.items()})
        return all_drawn.select(kept.index.to(rest.device)), ranked

    def _to_mesh(
        self, placement: Placement, objects: PlacedObjects, kept: Candidates, rest: Tensor
    ) -> tuple[HandParameters, Tensor, Tensor]:
        """Parameters and vertices (n, V, 3) as `Placement.hands_to_mesh` gives them, and distances (n, V) to the object
        by the atlas. Full batches again, so that no grasp depends on how many there are."""
        n = len(kept.ways)
        rows = torch.arange(-(-n // self.batch_size) * self.batch_size, device=rest.device) % n
        batches = []
        for row in rows.split(self.batch_size):
            hands, ways = kept.select(row)
            distances = objects.select(ways).signed_distances(self.hand(hands, rest).vertices)
            parameters, vertices = placement.hands_to_mesh(hands, ways, self.hand, rest)
            batches.append((*parameters, vertices, distances))
        *parameters, vertices, distances = (torch.cat(parts)[:n] for parts in zip(*batches, strict=True))
        return HandParameters(*parameters), vertices, distances


def _measure(query: MeshQuery, vertices: Tensor, distances: Tensor) -> None:
    """Replace the atlas's distances (N, V) of vertices (N, V, 3) by exact ones, wherever they are near the surface."""
    near = distances < _EXACT_WITHIN
    distances[near] = query.signed_distance(vertices[near])


def _turns(orientation: str, n: int, seed: int) -> Tensor:
    """(up to n, 3, 3) rotations of the object; row i depends on the seed and i alone."""
    rng = np.random.default_rng([seed, 1])
    if orientation == "upright":
        # Golden angles: however few of them are used, they are spread around evenly.
        return about_z(torch.from_numpy(rng.uniform(0, 2 * np.pi) + np.arange(n) * _GOLDEN_ANGLE).float())
    if orientation == "fixed":
        return torch.eye(3).unsqueeze(0)
    return quaternion_to_matrix(torch.from_numpy(rng.standard_normal((n, 4), np.float32)))
