"""Grabber: grasps of any mesh from the two trained networks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import roma
import torch
from torch import Tensor, nn

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel, HandParameters
from grabnet.errors import UserError
from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.rotations import about_z
from grabnet.geometry.sdf_grid import SDFGrid
from grabnet.grasps import Grasps
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.refinenet import RefineNet

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

    @torch.inference_mode()
    def grasp(
        self,
        mesh: Mesh,
        n: int,
        seed: int = 0,
        side: str = "right",
        orientation: str = "upright",
        betas: Tensor | None = None,
        to_object: np.ndarray | None = None,
        cache_dir: str | Path | None = None,
    ) -> Grasps:
        """Sample n grasps of a mesh.

        Args:
            mesh: the object in its own frame and units, open or closed.
            seed: grasp i of a seed is the same for every n.
            side: "left" grasps the mirrored object with the right-hand networks and mirrors the result back.
            orientation: how the object stands before the hand: "upright", turned about its vertical from grasp to
                grasp, in golden angles from a random one; "fixed", as in its file; "random", turned anyhow.
            betas: (n_betas,) shape of the hand; its mean when omitted.
            to_object: (4, 4) from the mesh's frame and units to metres, z up (`file_to_object`); identity when omitted.
            cache_dir: of the signed-distance grid, as in `SDFGrid.load_or_build`.
        """
        device = self.mirror.device
        to_object = np.eye(4) if to_object is None else np.asarray(to_object, np.float64)
        betas = self.hand.shapedirs.new_zeros(self.hand.shapedirs.shape[-1]) if betas is None else betas.to(device)
        rest = self.hand.shaped(betas)
        solid = mesh.transformed(to_object)
        atlas = SDFAtlas([SDFGrid.load_or_build(solid, cache_dir)]).to(device)
        centroid = torch.as_tensor(solid.centroid, device=device)
        # Right hands live in a world that, for a left grasp, is the mirror image of the one asked for. In that world
        # the object stands turned and mirrored: one orthogonal matrix.
        mirror = self.mirror if _one_of("side", side, SIDES) == "left" else torch.eye(3, device=device)
        turns = _turns(orientation, self.n_turns, seed).to(device)
        poses = turns @ mirror
        bps = self._encode(atlas, poses[:n], centroid)
        latent = _latent(-(-n // self.batch_size) * self.batch_size, self.coarsenet.latent_dim, seed).to(device)
        turn = torch.arange(len(latent), device=device) % len(bps)
        found = [
            self._batch(atlas, centroid, poses[t], z, bps[t], rest)
            for t, z in zip(turn.split(self.batch_size), latent.split(self.batch_size), strict=True)
        ]
        hands = HandParameters(*(torch.cat(x)[:n] for x in zip(*(parameters for parameters, _ in found), strict=True)))
        distances = torch.cat([d for _, d in found])[:n]

        # The object's rigid pose (rotation, offset) in the world asked for, from its mesh's axes and origin in metres.
        scale = np.linalg.det(to_object[:3, :3]) ** (1 / 3)
        axes, shift = (torch.as_tensor(x, device=device, dtype=torch.float32) for x in _rigid(to_object, scale))
        turned = mirror @ turns[turn[:n]] @ mirror
        rotation, offset = turned @ axes, turned @ (shift - centroid)
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

    def _encode(self, atlas: SDFAtlas, poses: Tensor, centroid: Tensor) -> Tensor:
        """BPS (K, P) of the object in orthogonal poses (K, 3, 3)."""
        objects = torch.zeros(len(poses), dtype=torch.int64, device=poses.device)
        return self.coarsenet.bps.from_atlas(atlas, objects, poses, centroid.expand(len(poses), 3))

    def _batch(
        self, atlas: SDFAtlas, centroid: Tensor, poses: Tensor, z: Tensor, bps: Tensor, rest: Tensor
    ) -> tuple[HandParameters, Tensor]:
        """Right hands in the centred world of objects in orthogonal poses (B, 3, 3), and their distances (B, V)."""
        objects = torch.zeros(len(z), dtype=torch.int64, device=z.device)

        def distances(vertices: Tensor) -> Tensor:
            return atlas(vertices @ poses + centroid, objects)

        hands = self.coarsenet.decode(z, bps)
        if self.refinenet is not None:
            hands = self.refinenet(hands, distances, rest)
        return hands, distances(self.hand(hands, rest).vertices)


def _measure(query: MeshQuery, vertices: Tensor, distances: Tensor) -> None:
    """Replace the atlas's distances (N, V) of vertices (N, V, 3) by exact ones, wherever they are near the surface."""
    near = distances < _EXACT_WITHIN
    distances[near] = query.signed_distance(vertices[near])


def _rigid(similarity: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and offset (3,) of a (4, 4) similarity of known scale."""
    return similarity[:3, :3] / scale, similarity[:3, 3]


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
    quaternion = torch.from_numpy(rng.standard_normal((n, 4), np.float32))
    return roma.unitquat_to_rotmat(quaternion / quaternion.norm(dim=1, keepdim=True))


def _one_of(name: str, value: str, options: tuple[str, ...]) -> str:
    if value not in options:
        raise UserError(f"{name} is '{value}'; it can be {', '.join(options)}.")
    return value
