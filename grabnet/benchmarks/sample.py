"""Sampling grasps of one mesh with networks of the published size, untrained: weights do not change the time.

And what follows the networks: optimising a batch of hands.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable

import torch
from torch import Tensor

from grabnet.benchmarks.run import BenchmarkConfig
from grabnet.benchmarks.scene import meshes
from grabnet.benchmarks.timing import Case
from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.generation.grabber import Grabber
from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.bps import BPS
from grabnet.geometry.rotations import random_rotations
from grabnet.geometry.sdf_grid import SDFGrid
from grabnet.grasping.grasp_hand import GraspHand, GraspPose, Sampled
from grabnet.grasping.optimiser import GraspOptimiser, OptimiserConfig
from grabnet.grasping.spheres import overlaps
from grabnet.grasping.surface import AtlasSurface
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.grabnet import GrabNet
from grabnet.models.refinenet import RefineNet

N_GRASPS = 1000
N_BEST = 100
# Surface samples that the plain way measures distances to (ref. 2), and encodes the object by.
N_SAMPLES = 2048


def cases(settings: BenchmarkConfig) -> list[Case]:
    torch.manual_seed(settings.seed)
    hand = HandModel.open()
    whole = Grabber(GrabNet(CoarseNet(BPS()), RefineNet(hand)), hand).to(settings.device)
    refined = whole.changed(optimise=0, candidates=1)
    coarse = refined.changed(generator=GrabNet(refined.generator.coarsenet))
    mesh = meshes()[0]
    points = torch.tensor(mesh.sample_surface(N_SAMPLES)[0] - mesh.centroid, device=settings.device)

    def new_mesh() -> None:
        with tempfile.TemporaryDirectory() as empty:
            whole(mesh, 20, cache_dir=empty)

    plain = f"{N_GRASPS} grasps, distances by cdist"
    iterations = OptimiserConfig().iterations
    plainly = f"{refined.batch_size} hands optimised, {iterations} iterations, torch's gradients"
    return [
        Case(plain, lambda: _plain(refined, points), runs=2),
        Case(f"{N_GRASPS} grasps", lambda: refined(mesh, N_GRASPS), (plain,)),
        Case(f"{N_GRASPS} grasps, not refined", lambda: coarse(mesh, N_GRASPS)),
        Case(f"{N_BEST} grasps, the best of {whole.candidates} times as many, optimised", lambda: whole(mesh, N_BEST)),
        Case(f"20 grasps of a mesh not met before ({len(mesh.faces)} faces)", new_mesh),
        Case(plainly, _optimising(refined, PlainHand, settings.device), runs=2),
        Case(
            f"{refined.batch_size} hands optimised, {iterations} iterations",
            _optimising(refined, GraspHand, settings.device),
            (plainly,),
        ),
    ]


class PlainHand(GraspHand):
    """Differentiated by torch, step by step; every pair of spheres compared."""

    def sampled(self, pose: GraspPose) -> tuple[Tensor, Sampled]:
        posed = self.posed(pose, self.sample)
        facing = self.posed_normals(posed.rotations, self.sample[self.pads].flatten()).unflatten(1, self.pads.shape)
        parts = (posed.vertices, posed.spheres, posed.forearm)
        return torch.cat(parts, 1), Sampled(*parts, facing)

    def self_overlap(self, spheres: Tensor) -> Tensor:
        return overlaps(spheres, self.apart).square().sum((1, 2)) / 2


def _optimising(grabber: Grabber, kind: type[GraspHand], device: str) -> Callable[[], object]:
    """Hands as an untrained network draws them, about the mesh's middle, to be optimised."""
    mesh = meshes()[0]
    model = grabber.hand
    hand = kind(model, Anatomy.of(model), model.shapedirs.new_zeros(10))
    surface = AtlasSurface(SDFAtlas([SDFGrid.load_or_build(mesh)]).to(device))
    start = hand.pose_of(grabber(mesh, grabber.batch_size).parameters)
    start = GraspPose(*(x.to(device) for x in start))
    optimise = GraspOptimiser(hand, OptimiserConfig())
    return lambda: optimise(start, surface)


@torch.inference_mode()
def _plain(grabber: Grabber, points: Tensor) -> None:
    """As many grasps, each of the object turned again, but without report: no exact penetration, no contact."""
    poses = random_rotations(N_GRASPS, torch.Generator().manual_seed(0)).to(points.device)
    coarsenet, refinenet = grabber.generator.coarsenet, grabber.generator.refinenet
    for pose in poses.split(grabber.batch_size):
        clouds = points @ pose.mT
        bps = torch.cat([coarsenet.bps.encode(cloud)["dists"] for cloud in clouds])
        hands = coarsenet.decode(torch.randn(len(bps), coarsenet.latent_dim, device=bps.device), bps)
        refinenet(hands, lambda v, c=clouds: torch.cdist(v, c).amin(-1))
