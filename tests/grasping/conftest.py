from __future__ import annotations

import pytest
import torch
from torch import Tensor

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.grasping.grasp_hand import GraspHand
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
