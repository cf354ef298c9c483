"""Grabber: grasps of any mesh from the two trained networks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel, HandParameters
from grabnet.errors import UserError
from grabnet.generation.grasps import Grasps
from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.mesh import Mesh, file_to_object, load_mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.rotations import about_z, quaternion_to_matrix
from grabnet.geometry.sdf_grid import SDFGrid
from grabnet.io.files import existing
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.refinenet import RefineNet
from grabnet.models.trained import OPEN_GRABBER, check_hand
from grabnet.models.weights import load_coarsenet, load_refinenet, weights_file

SIDES = ("right", "left")
ORIENTATIONS = ("upright", "fixed", "random")
# Vertices that the atlas puts farther than this (metres) outside are not measured exactly: neither contact nor
# penetration can depend on them, and they are most of the hand.
_EXACT_WITHIN = 0.01
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


class Grabber(nn.Module):
    """CoarseNet's guess, corrected by RefineNet.

    Args:
        coarsenet: trained on right hands, like `refinenet`; without the latter the guess is the grasp.
        hand: right hand model, the one the networks were trained with.
        batch_size: hands posed at once. The last batch is filled up, so that no result depends on how many are wanted.
        n_turns: ways the object is turned before the hand; grasps take them in rotation. Each costs an encoding of the
            object, which takes longer than the grasp itself.
    """

    def __init__(
        self,
        coarsenet: CoarseNet,
        refinenet: RefineNet | None,
        hand: HandModel,
        batch_size: int = 256,
        n_turns: int = 128,
    ):
        super().__init__()
        self.coarsenet, self.refinenet, self.hand = coarsenet.eval(), refinenet and refinenet.eval(), hand
        self.batch_size, self.n_turns = batch_size, n_turns
        self.register_buffer("finger", Anatomy.of(hand).finger, persistent=False)
        self.register_buffer("mirror", torch.diag(torch.tensor([-1.0, 1.0, 1.0])), persistent=False)

    @classmethod
    def from_pretrained(cls, name: str | Path = "open", hand: HandModel | None = None, **options: int) -> Grabber:
        """A trained pair of networks.

        Args:
            name: "open", the shipped ones, trained on the open data; or a folder with run folders `coarsenet` and
                `refinenet`, such as a run of model=grabnet or `runs/demo`.
            hand: the right hand they were trained with; the open hand when omitted.
            options: further arguments of the constructor.

        Raises:
            UserError: no such networks, or trained with another hand.
        """
        folder = OPEN_GRABBER if name == "open" else existing(name, 'Only "open" or a folder can be named:')
        hand = hand or HandModel.open()
        coarsenet, refinenet = (weights_file(folder / network) for network in ("coarsenet", "refinenet"))
        for path in (coarsenet, refinenet):
            check_hand(path, hand)
        return cls(load_coarsenet(coarsenet), load_refinenet(refinenet, hand), hand, **options)

    @torch.inference_mode()
    def forward(
        self,
        mesh: Mesh | str | Path,
        n: int = 20,
        seed: int = 0,
        side: str = "right",
        orientation: str = "upright",
        betas: Tensor | None = None,
        to_object: np.ndarray | None = None,
        cache_dir: str | Path | None = None,
    ) -> Grasps:
        """Sample n grasps of a mesh.

        Args:
            mesh: the object in its own frame and units, open or closed; or a file of one, in metres.
            seed: grasp i of a seed is the same for every n.
            side: "left" grasps the mirrored object with the right-hand networks and mirrors the result back.
            orientation: how the object stands before the hand: "upright", turned about its vertical from grasp to
                grasp, in golden angles from a random one; "fixed", as in its file; "random", turned anyhow.
            betas: (n_betas,) shape of the hand; its mean when omitted.
            to_object: (4, 4) from the mesh's frame and units to metres, z up. When omitted that of `file_to_object` for
                a file, and the identity for a mesh.
            cache_dir: of the signed-distance grid, as in `SDFGrid.load_or_build`.

        Raises:
            UserError: an unreadable file, or an option that there is not.
        """
        device = self.mirror.device
        if not isinstance(mesh, Mesh):
            to_object = file_to_object(mesh) if to_object is None else to_object
            mesh = load_mesh(mesh)
        to_object = np.eye(4) if to_object is None else np.asarray(to_object, np.float64)
        betas = self.hand.shapedirs.new_zeros(self.hand.shapedirs.shape[-1]) if betas is None else betas.to(device)
        rest = self.hand.shaped(betas)
        solid = mesh.transformed(to_object)
        atlas = SDFAtlas([SDFGrid.load_or_build(solid, cache_dir)]).to(device)
        centroid = torch.as_tensor(solid.centroid, device=device)
        # Right hands live in a world that, for a left grasp, is the mirror image of the one asked for. In that world
        # the object stands turned and mirrored: one orthogonal matrix.
        mirror = self.mirror if _one_of("side", side, SIDES) == "left" else torch.eye(3, device=device)
        turns = _turns(orientation, min(n, self.n_turns), seed).to(device)
        hands, distances = self._sample(atlas, centroid, turns @ mirror, n, seed, rest)

        # The object's rigid pose (rotation, offset) in the world asked for, from its mesh's axes and origin in metres.
        scale = np.linalg.det(to_object[:3, :3]) ** (1 / 3)
        axes = torch.as_tensor(to_object[:3, :3] / scale, device=device, dtype=torch.float32)
        shift = torch.as_tensor(to_object[:3, 3], device=device, dtype=torch.float32)
        turned = mirror @ turns[torch.arange(n, device=device) % len(turns)] @ mirror
        rotation, offset = turned @ axes, turned @ (shift - centroid)
        # The way back is the inverse motion; the hands take it as right hands still, in the mirrored frame.
        back = (mirror @ rotation @ mirror).mT
        hands = self.hand.moved(hands, back, -(back @ (offset @ mirror).unsqueeze(-1)).squeeze(-1), rest)
        vertices = self.hand(hands, rest).vertices @ mirror
        _measure(MeshQuery(solid, device), vertices @ axes.mT + shift, distances)

        transform = torch.eye(4, device=device).repeat(n, 1, 1)
        transform[:, :3, :3], transform[:, :3, 3] = rotation * scale, offset
        return Grasps(
            mesh=mesh,
            to_object=to_object,
            side=side,
            seed=seed,
            parameters=HandParameters(*(x.cpu() for x in _mirrored(hands, mirror))),
            betas=betas.expand(n, -1).cpu(),
            object_transform=transform.cpu(),
            vertices=(vertices / scale).cpu(),
            faces=(self.hand.faces if side == "right" else self.hand.faces.flip(1)).cpu(),
            finger=self.finger.cpu(),
            distances=distances.cpu(),
        )

    def _sample(
        self, atlas: SDFAtlas, centroid: Tensor, poses: Tensor, n: int, seed: int, rest: Tensor
    ) -> tuple[HandParameters, Tensor]:
        """n right hands in the centred world of one object, and their distances (n, V) to it by the atlas.

        Args:
            poses: (K, 3, 3) orthogonal, of the object in the world; grasps take them in rotation.
        """
        n_filled = -(-n // self.batch_size) * self.batch_size
        latent = _latent(n_filled, self.coarsenet.latent_dim, seed).to(centroid.device)
        order = torch.arange(n_filled, device=centroid.device) % len(poses)
        objects = torch.zeros_like(order)  # the atlas holds but this one
        bps = self.coarsenet.bps.from_atlas(atlas, objects[: len(poses)], poses, centroid.expand(len(poses), 3))
        batches = []
        for z, chosen in zip(latent.split(self.batch_size), order.split(self.batch_size), strict=True):
            pose = poses[chosen]

            def distances(vertices: Tensor, pose: Tensor = pose) -> Tensor:
                return atlas(vertices, objects[: len(pose)], pose, centroid.expand(len(pose), 3))

            hands = self.coarsenet.decode(z, bps[chosen])
            if self.refinenet is not None:
                hands = self.refinenet(hands, distances, rest)
            batches.append((*hands, distances(self.hand(hands, rest).vertices)))
        *parameters, measured = (torch.cat(parts)[:n] for parts in zip(*batches, strict=True))
        return HandParameters(*parameters), measured


def _measure(query: MeshQuery, vertices: Tensor, distances: Tensor) -> None:
    """Replace the atlas's distances (N, V) of vertices (N, V, 3) by exact ones, wherever they are near the surface."""
    near = distances < _EXACT_WITHIN
    distances[near] = query.signed_distance(vertices[near])


def _mirrored(hands: HandParameters, mirror: Tensor) -> HandParameters:
    """The hands seen through the orthogonal matrix `mirror`: parameters of the mirrored hand model."""
    return HandParameters(
        mirror @ hands.global_orient @ mirror, mirror @ hands.hand_pose @ mirror, hands.transl @ mirror
    )


def _latent(n: int, dim: int, seed: int) -> Tensor:
    """(n, dim) standard normal; row i depends on the seed and i alone."""
    return torch.from_numpy(np.random.default_rng([seed, 0]).standard_normal((n, dim), np.float32))


def _turns(orientation: str, n: int, seed: int) -> Tensor:
    """(up to n, 3, 3) rotations of the object; row i depends on the seed and i alone."""
    rng = np.random.default_rng([seed, 1])
    if _one_of("orientation", orientation, ORIENTATIONS) == "upright":
        # Golden angles: however few of them are used, they are spread around evenly.
        return about_z(torch.from_numpy(rng.uniform(0, 2 * np.pi) + np.arange(n) * _GOLDEN_ANGLE).float())
    if orientation == "fixed":
        return torch.eye(3).unsqueeze(0)
    return quaternion_to_matrix(torch.from_numpy(rng.standard_normal((n, 4), np.float32)))


def _one_of(name: str, value: str, options: tuple[str, ...]) -> str:
    if value not in options:
        raise UserError(f"{name} is '{value}'; it can be {', '.join(options)}.")
    return value
