"""Sampling grasps of one mesh with networks of the published size, untrained: weights do not change the time."""

from __future__ import annotations

import tempfile

import torch
from torch import Tensor

from grabnet.benchmarks.run import BenchmarkConfig
from grabnet.benchmarks.scene import meshes
from grabnet.benchmarks.timing import Case
from grabnet.body.hand import HandModel
from grabnet.generation.grabber import Grabber
from grabnet.geometry.bps import BPS
from grabnet.geometry.rotations import random_rotations
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.grabnet import GrabNet
from grabnet.models.refinenet import RefineNet

N_GRASPS = 1000
# Surface samples that the plain way measures distances to (ref. 2), and encodes the object by.
N_SAMPLES = 2048


def cases(settings: BenchmarkConfig) -> list[Case]:
    torch.manual_seed(settings.seed)
    hand = HandModel.open()
    refined = Grabber(GrabNet(CoarseNet(BPS()), RefineNet(hand)), hand).to(settings.device)
    coarse = Grabber(GrabNet(refined.generator.coarsenet), hand).to(settings.device)
    mesh = meshes()[0]
    points = torch.tensor(mesh.sample_surface(N_SAMPLES)[0] - mesh.centroid, device=settings.device)

    def new_mesh() -> None:
        with tempfile.TemporaryDirectory() as empty:
            refined(mesh, 20, cache_dir=empty)

    plain = f"{N_GRASPS} grasps, distances by cdist"
    return [
        Case(plain, lambda: _plain(refined, points), runs=2),
        Case(f"{N_GRASPS} grasps", lambda: refined(mesh, N_GRASPS), (plain,)),
        Case(f"{N_GRASPS} grasps, not refined", lambda: coarse(mesh, N_GRASPS)),
        Case(f"20 grasps of a mesh not met before ({len(mesh.faces)} faces)", new_mesh),
    ]


@torch.inference_mode()
def _plain(grabber: Grabber, points: Tensor) -> None:
    """As many grasps, each of the object turned anew, but without report: no exact penetration, no contact."""
    poses = random_rotations(N_GRASPS, torch.Generator().manual_seed(0)).to(points.device)
    coarsenet, refinenet = grabber.generator.coarsenet, grabber.generator.refinenet
    for pose in poses.split(grabber.batch_size):
        clouds = points @ pose.mT
        bps = torch.cat([coarsenet.bps.encode(cloud)["dists"] for cloud in clouds])
        hands = coarsenet.decode(torch.randn(len(bps), coarsenet.latent_dim, device=bps.device), bps)
        refinenet(hands, lambda v, c=clouds: torch.cdist(v, c).amin(-1))
