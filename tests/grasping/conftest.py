from __future__ import annotations

import copy

import pytest
import torch
from torch import Tensor

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.geometry.rotations import random_rotations
from grabnet.grasping.grasp_hand import GraspHand, GraspPose
from grabnet.grasping.proposing.templates import TemplateConfig, build_templates, natural_limits


@pytest.fixture(scope="session")
def model() -> HandModel:
    return HandModel.open()


@pytest.fixture(scope="session")
def anatomy(model) -> Anatomy:
    return Anatomy.of(model)


@pytest.fixture(scope="session")
def hand(model, anatomy) -> GraspHand:
    return GraspHand(model, anatomy, torch.zeros(10))


@pytest.fixture(scope="session")
def limits(anatomy) -> Tensor:
    return natural_limits(anatomy, TemplateConfig())


@pytest.fixture(scope="session")
def templates(hand, limits):
    """Coarser than the shipped ones, in a fifth of the time."""
    torch.set_num_threads(1)
    return build_templates(hand, limits, TemplateConfig(openings=9, iterations=120, learning_rate=0.04))


@pytest.fixture(scope="session")
def precise() -> GraspHand:
    """The same hand in double precision, for finite differences."""
    model = HandModel.open(dtype=torch.float64)
    return GraspHand(model, Anatomy.of(model), torch.zeros(10, dtype=torch.float64))


@pytest.fixture(scope="session")
def turned() -> tuple[GraspHand, torch.Tensor]:
    """A hand whose model lies another way in its coordinates, and the rotation by which."""
    model = copy.deepcopy(HandModel.open())
    rotation = random_rotations(1, torch.Generator().manual_seed(3))[0]
    model.v_template.copy_(model.v_template @ rotation.mT)
    model.shapedirs.copy_(torch.einsum("ij,vjn->vin", rotation, model.shapedirs))
    return GraspHand(model, Anatomy.of(model), torch.zeros(10)), rotation


@pytest.fixture(scope="session")
def left() -> GraspHand:
    """The mirrored hand: x ↦ −x."""
    model = HandModel.open("left")
    return GraspHand(model, Anatomy.of(model), torch.zeros(10))


def poses(n: int, seed: int = 0, dtype: torch.dtype = torch.float32) -> GraspPose:
    """Hands anyhow, half closed, their wrists within decimetres of the origin."""
    generator = torch.Generator().manual_seed(seed)
    rotation = random_rotations(n, generator, dtype)
    wrist = 0.2 * torch.randn(n, 3, generator=generator).to(dtype)
    return GraspPose(rotation, wrist, 0.6 * torch.rand(n, 21, generator=generator).to(dtype))
