"""A generator without a network: templates of human grasps put where they fit an object (ref. 15)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from grabnet.body.hand import HandParameters
from grabnet.geometry.conventions import Conventions
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.placed import PlacedObjects
from grabnet.grasping.grasp_hand import GraspHand
from grabnet.grasping.proposing.grasped_object import GraspedObject, part
from grabnet.grasping.proposing.posture import PostureConfig
from grabnet.grasping.proposing.proposals import ProposalConfig, propose
from grabnet.grasping.proposing.templates import Template
from grabnet.models.generator import GraspGenerator

_SURFACE_POINTS = 6000


class TemplateGenerator(GraspGenerator):
    """Proposes grasps of one object as synthesis does before it optimises and tests them; no part of it is preferred.

    Args:
        mesh: of the object, metres, z up.
        hand: right, of the shape that the templates are for.
        templates: of this hand, by kind.
        cache_dir: of signed-distance grids, as in `SDFGrid.load_or_build`.
    """

    noise_dim = 1
    conventions = Conventions()

    def __init__(self, mesh: Mesh, hand: GraspHand, templates: dict[str, Template], cache_dir: str | Path | None):
        super().__init__()
        self.hand, self.templates = hand, templates
        whole = part(mesh, *mesh.bounds, 1.0, _SURFACE_POINTS, seed=0)
        self.object = GraspedObject("", mesh, [whole], cache_dir)
        self.config = replace(ProposalConfig(), worst=torch.inf)  # as many as are asked for

    def encode(self, objects: PlacedObjects) -> Tensor:
        return objects.centres.new_zeros(len(objects), 0)

    def sample(self, code: Tensor, objects: PlacedObjects, noise: Tensor, rest: Tensor) -> HandParameters:
        """As `GraspGenerator.sample`; a batch is drawn as a whole, from its noise."""
        seed = int(noise.double().abs().sum() * 1e6)
        generator = torch.Generator().manual_seed(seed)
        n = len(noise)
        pose = propose(self.object, self.hand, self.templates, n, generator, self.config, PostureConfig()).pose
        world = objects.rotations.cpu()
        wrist = (world @ (pose.wrist - objects.centres.cpu()).unsqueeze(-1)).squeeze(-1)
        hands = self.hand.parameters(pose._replace(rotation=world @ pose.rotation, wrist=wrist))
        return HandParameters(*(x.to(noise) for x in hands))
