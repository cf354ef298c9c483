"""Stage I: where a subject's markers really sit, from a few frames (paper 3.2, S.8).

Unknown are the markers' places on the resting body, which all frames share, and the pose of each frame. The poses are
eliminated from the normal equations frame by frame (Schur complement); what is left has three unknowns a marker, and
the betas where no scan gave the shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import torch
from torch import Tensor

from grabnet.body.anatomy import vertex_normals
from grabnet.body.whole import BodyModel
from grabnet.cli.checks import Amount, Count, Filled, Positive, in_range
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.mosh.attachment import Attachment, Pose
from grabnet.mosh.frames import FrameProblem, missing_factor
from grabnet.mosh.layouts import Layout
from grabnet.mosh.placing import marker_positions
from grabnet.mosh.priors import PriorConfig, joint_prior
from grabnet.mosh.relabelling import relabelled
from grabnet.mosh.starting import start
from grabnet.mosh.terms import MarkerTerm, PosePrior

_TRUNK = (0, 3, 6, 9)  # joints
_REATTACH = 2  # steps after which markers are attached to the skin that is then beneath them


@dataclass(frozen=True)
class StageOneConfig:
    """How places are found. Lengths are metres, standard deviations.

    Attributes:
        frames: that are looked at.
        noise: of a marker in a frame.
        reach: standard deviations beyond which a marker loses its say.
        ring: of a marker's true place from the layout's, along the skin, in mean lengths of the edges around it.
        place: the same for all markers, in metres; replaces `ring`.
        surface: of a marker's distance to the skin from the layout's.
        annealing: factors of the pose prior, one round each (ref. 5).
        iterations: of each round.
        betas: shape coefficients to solve for; 0 where a scan gives the shape.
        doubt: metres by which a marker's distances to its neighbours may be unusual; see `undoubted`.
        relabel: metres within which a marker that fits another label than its own takes that; see `relabelled`.

    Raises:
        UserError: a value out of range.
    """

    frames: Count = 12
    noise: Positive = 0.0015
    reach: Positive = 10.0
    ring: Positive = 0.45
    place: Positive | None = None
    surface: Positive = 0.0005
    annealing: Annotated[Sequence[Positive], Filled()] = (1.0, 1.0, 1.0)
    iterations: Count = 12
    betas: Amount = 0
    doubt: Positive = 0.005
    relabel: Positive = 0.01

    def __post_init__(self):
        in_range(self, "stage_one.")


@dataclass(frozen=True)
class StageOne:
    """What Stage I found.

    Attributes:
        layout: the markers, at the places of the skin beneath them.
        latent: (M, 3) float64, their places at rest, metres.
        v_template: (V, 3) the resting body, in the shape that was given or found.
        betas: (S,) shape found; empty where it was given.
        poses: of the frames, to start from elsewhere.
        residuals: (F, M) distances in these frames, metres; NaN where missing.
    """

    layout: Layout
    latent: Tensor
    v_template: Tensor
    betas: Tensor
    poses: Pose
    residuals: Tensor


def stage_one(
    body: BodyModel,
    v_template: Tensor,
    layout: Layout,
    positions: np.ndarray,
    config: StageOneConfig,
    prior: PriorConfig,
    directions: Tensor | None = None,
) -> StageOne:
    """Find the places of a subject's markers.

    Args:
        body: in SMPL-X's schema.
        v_template: (V, 3) of the subject, or the model's own where betas are solved for.
        layout: about where they sit.
        positions: (F, M, 3) the markers of the chosen frames, metres, in the layout's order; NaN where missing.
        config: the settings.
        prior: of poses.
        directions: (V, 3, S) expression directions that are solved for in each frame; not with betas.
    """
    shared_shape = config.betas > 0
    dirs = body.shapedirs[..., : config.betas] if shared_shape else directions
    solver = _Solver(body, v_template, layout, torch.as_tensor(positions), config, prior, dirs, shared_shape)
    for round_, factor in enumerate(config.annealing):
        if round_:
            solver.relabel()
        for number in range(config.iterations):
            solver.step(factor, 3 if round_ == 0 else 1)
            if number % _REATTACH == _REATTACH - 1:
                solver.reattach()
    solver.reattach()
    return solver.result()


def on_trunk(attachment: Attachment) -> Tensor:
    """(M,) which markers move with the trunk more than with anything else."""
    return attachment.weights[:, _TRUNK].sum(1) > 0.6


class _Solver:
    """The state of Stage I: places, poses, and what they are attached to."""

    def __init__(self, body, v_template, layout, observed, config, prior, directions, shared_shape):
        self.body, self.config, self.shared_shape = body, config, shared_shape
        self.template, self.layout, self.given = v_template, layout, observed.double()
        self.observed = self.given
        self.directions = directions
        self.prior_config, self.prior = prior, joint_prior(body, prior)
        self.distance = torch.tensor([marker.distance for marker in layout.markers]).double()
        self.spread = config.ring * _edges_around(v_template.double(), body.faces, layout)
        if config.place is not None:
            self.spread = torch.full_like(self.spread, config.place)
        self.sigma = torch.full((len(layout.markers),), config.noise, dtype=torch.float64)
        normals = vertex_normals(v_template.double(), body.faces)
        self.guess = torch.as_tensor(marker_positions(layout, v_template.double().numpy(), normals.numpy()))
        self.latent, self.damping = self.guess.clone(), 1e-3
        self.query = MeshQuery(Mesh(v_template.numpy(), body.faces.numpy()))
        self.normals = normals
        self.reattach()
        trunk = on_trunk(self.attachment)
        self.pose, _ = start(self._problem(1.0, 1.0), self.prior, trunk)
        if shared_shape:
            self.pose.shape[:] = 0

    def reattach(self) -> None:
        """Attach the markers to the skin that is now nearest to them."""
        found = self.query.closest(self.latent.float())
        corners = self.body.faces[found.face]
        weights = _barycentric(found.position.double(), self.template.double()[corners])
        markers = tuple(
            replace(marker, vertices=tuple(corner.tolist()), weights=tuple(weight.tolist()))
            for marker, corner, weight in zip(self.layout.markers, corners, weights, strict=True)
        )
        self.layout = Layout(self.layout.name, self.layout.n_vertices, markers)
        normals = (self.normals[corners] * weights.unsqueeze(-1)).sum(1)
        self.normal = normals / normals.norm(dim=-1, keepdim=True)
        self.foot = (self.template.double()[corners] * weights.unsqueeze(-1)).sum(1)
        self.attachment = Attachment(
            self.body, self.template, self.layout, self.latent, self.directions, torch.float64, self.prior_config.fixed
        )

    def relabel(self) -> None:
        """Give markers the labels that they fit."""
        self.observed = relabelled(self.attachment.place(self.pose).points, self.given, self.config.relabel)

    def step(self, factor: float, reach: float) -> None:
        """One step of Levenberg and Marquardt on places and poses together."""
        problem = self._problem(factor, reach)
        f, m, s = len(self.observed), len(self.latent), self.attachment.n_shapes * self.shared_shape
        normal, cross, shared, gradient = self._equations(problem)
        n_pose = self.attachment.n - s
        hessian = normal.hessian[:, :n_pose, :n_pose].clone()
        if s:
            shape = slice(n_pose, None)
            cross = torch.cat([cross[:, :n_pose], normal.hessian[:, :n_pose, shape]], -1)
            shared = torch.block_diag(shared, normal.hessian[:, shape, shape].sum(0))
            corner = self._last_cross
            shared[: 3 * m, 3 * m :], shared[3 * m :, : 3 * m] = corner, corner.T
            gradient = torch.cat([gradient, normal.gradient[:, shape].sum(0)])
        for matrix in (hessian, shared):
            matrix.diagonal(dim1=-2, dim2=-1).mul_(1 + self.damping).add_(1e-9)
        lower = torch.linalg.cholesky(hessian)
        pull = normal.gradient[:, :n_pose]
        solved = torch.cholesky_solve(torch.cat([cross, pull.unsqueeze(-1)], -1), lower)
        reduced = shared - (cross.mT @ solved[..., :-1]).sum(0)
        right = gradient - (cross.mT @ solved[..., -1:]).sum((0, 2))
        change = -torch.linalg.solve(reduced, right)
        poses = -solved[..., -1] - (solved[..., :-1] @ change)
        delta = torch.cat([poses, change[3 * m :].expand(f, -1)], 1)
        before = self._cost(problem, self.pose, self.latent)
        latent = self.latent + change[: 3 * m].view(m, 3)
        pose = self.attachment.moved(self.pose, delta)
        if self._cost(problem, pose, latent) < before:
            self.pose, self.latent, self.damping = pose, latent, max(self.damping * 0.2, 1e-7)
            self.attachment.latent = latent
        else:
            self.damping = min(self.damping * 10, 1e3)

    def _equations(self, problem: FrameProblem):
        """Of the poses, of poses and places (F, n, 3M), of the places (3M, 3M), and their gradient (3M,)."""
        normal = problem.normal(self.pose)
        placed = self.attachment.place(self.pose)
        jacobian = self.attachment.jacobian(self.pose, placed).unflatten(2, (-1, 3))
        residuals = problem.markers.residuals(placed)
        square = residuals.square().sum(-1)
        kept = problem.markers._kept(square) * self.observed[..., 0].isfinite() / self.sigma**2  # (F, M)
        m = len(self.latent)
        cross = torch.einsum("fnmd,fmde,fm->fnme", jacobian, placed.maps, kept).flatten(2)
        blocks = torch.einsum("fmda,fmdb,fm->mab", placed.maps, placed.maps, kept)
        pull = torch.einsum("fmda,fmd,fm->ma", placed.maps, residuals * self.sigma[:, None], kept)
        self._last_cross = cross[:, self.attachment.n - self.attachment.n_shapes :].sum(0).T
        along, off = self._along(), self._off(self.latent)
        blocks += along + self.normal.unsqueeze(-1) * self.normal.unsqueeze(-2) / self.config.surface**2
        pull += (along @ (self.latent - self.guess).unsqueeze(-1)).squeeze(-1)
        pull += off.unsqueeze(-1) * self.normal / self.config.surface**2
        return normal, cross, torch.block_diag(*blocks), pull.reshape(3 * m)

    def _along(self) -> Tensor:
        """(M, 3, 3) inverse covariances of places from the layout's, along the skin."""
        flat = torch.eye(3).double() - self.normal.unsqueeze(-1) * self.normal.unsqueeze(-2)
        return flat / self.spread[:, None, None] ** 2

    def _off(self, latent: Tensor) -> Tensor:
        """(M,) by how much places are farther from the skin than they should be."""
        return ((latent - self.foot) * self.normal).sum(-1) - self.distance

    def _problem(self, factor: float, reach: float) -> FrameProblem:
        markers = MarkerTerm(self.observed, self.sigma, reach * self.config.reach)
        shape_sigma = torch.ones(self.attachment.n_shapes).double()
        if self.shared_shape:  # every frame counts the shared prior once: together it counts once
            shape_sigma *= len(self.observed) ** 0.5
        else:
            shape_sigma *= self.prior_config.expression
        prior = PosePrior(self.attachment, self.prior, shape_sigma)
        return FrameProblem(
            self.attachment, markers, prior, factor * missing_factor(self.observed, self.prior_config.missing)
        )

    def _cost(self, problem: FrameProblem, pose: Pose, latent: Tensor) -> Tensor:
        self.attachment.latent, kept = latent, self.attachment.latent
        cost = problem.cost(pose).sum()
        self.attachment.latent = kept
        off = latent - self.guess
        cost = cost + torch.einsum("ma,mab,mb->", off, self._along(), off) / 2
        return cost + self._off(latent).square().sum() / self.config.surface**2 / 2

    def result(self) -> StageOne:
        distances = (self.attachment.place(self.pose).points - self.observed).norm(dim=-1)
        template, latent, betas = self.template, self.latent, torch.zeros(0)
        if self.shared_shape:
            betas = self.pose.shape[0].float()
            template = self.body.shaped(betas, v_template=self.template)
            latent = self.attachment.rest(self.pose.frames(slice(0, 1)))[0]
        return StageOne(self.layout, latent, template, betas, self.pose, distances)


def _edges_around(vertices: Tensor, faces: Tensor, layout: Layout) -> Tensor:
    """(M,) mean length of the edges that meet where each marker sits, metres."""
    edges = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    length = (vertices[edges[:, 0]] - vertices[edges[:, 1]]).norm(dim=-1)
    total, count = torch.zeros(2, len(vertices), dtype=vertices.dtype)
    for end in edges.T:
        total.index_add_(0, end, length)
        count.index_add_(0, end, torch.ones_like(length))
    corners = torch.tensor([marker.vertices for marker in layout.markers])
    return (total / count.clamp_min(1))[corners].mean(1)


def _barycentric(points: Tensor, corners: Tensor) -> Tensor:
    """(M, 3) weights of points on triangles (M, 3, 3)."""
    edges = (corners[:, 1:] - corners[:, :1]).mT
    rest = torch.linalg.lstsq(edges, (points - corners[:, 0]).unsqueeze(-1)).solution.squeeze(-1).clamp(0, 1)
    return torch.cat([1 - rest.sum(1, keepdim=True), rest], 1)
