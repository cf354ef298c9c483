"""A generator without a network: templates of human grasps put where they fit an object (ref. 15)."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, cached_property
from pathlib import Path

import torch
from torch import Tensor

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel, HandParameters
from grabnet.geometry.conventions import Conventions
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.placed import PlacedObjects
from grabnet.grasping.grasp_hand import GraspHand
from grabnet.grasping.proposing.grasped_object import GraspedObject, part
from grabnet.grasping.proposing.posture import PostureConfig
from grabnet.grasping.proposing.proposals import ProposalConfig, propose
from grabnet.grasping.proposing.templates import Template, TemplateConfig, build_templates, natural_limits
from grabnet.models.generator import GraspGenerator

_SURFACE_POINTS = 6000


class TemplateGenerator(GraspGenerator):
    """Proposes grasps of one object as synthesis does before it optimises and tests them; no part of it is preferred.

    A batch is drawn as a whole, from its noise: grasp i depends on the others of its batch, too.

    Args:
        mesh: of the object, metres, z up.
        hand: right hand model, on the CPU.
        cache_dir: of signed-distance grids, as in `SDFGrid.load_or_build`.
    """

    noise_dim = 1
    conventions = Conventions()

    def __init__(self, mesh: Mesh, hand: HandModel, cache_dir: str | Path | None):
        super().__init__()
        self.mesh, self.cache_dir = mesh, cache_dir
        self._model = (hand,)  # not a part of this module, which would take it to another device
        self.config = replace(ProposalConfig(), worst=torch.inf)  # as many as are asked for

    @cached_property
    def grasped(self) -> GraspedObject:
        """The object, made when it is first grasped."""
        whole = part(self.mesh, *self.mesh.bounds, 1.0, _SURFACE_POINTS, seed=0)
        return GraspedObject("", self.mesh, [whole], self.cache_dir)

    def encode(self, objects: PlacedObjects) -> Tensor:
        return objects.centres.new_zeros(len(objects), 0)

    def sample(self, code: Tensor, objects: PlacedObjects, noise: Tensor, rest: Tensor) -> HandParameters:
        seed = int(noise.double().abs().sum() * 1e6)
        generator = torch.Generator().manual_seed(seed)
        n = len(noise)
        hand, templates = _templates(*self._model)
        pose = propose(self.grasped, hand, templates, n, generator, self.config, PostureConfig()).pose
        world = objects.rotations.cpu()
        wrist = (world @ (pose.wrist - objects.centres.cpu()).unsqueeze(-1)).squeeze(-1)
        hands = hand.parameters(pose._replace(rotation=world @ pose.rotation, wrist=wrist))
        return HandParameters(*(x.to(noise) for x in hands))


@cache
def _templates(hand: HandModel) -> tuple[GraspHand, dict[str, Template]]:
    """The mean hand, and templates for it; several seconds."""
    held = GraspHand(hand, Anatomy.of(hand), hand.shapedirs.new_zeros(hand.shapedirs.shape[-1]))
    with torch.enable_grad():  # they are optimised, when first asked for within a draw
        return held, build_templates(held, natural_limits(held.anatomy, TemplateConfig()))
