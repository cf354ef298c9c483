from __future__ import annotations

import pytest
import torch

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.grasping.grasp_hand import GraspHand


@pytest.fixture(scope="session")
def model() -> HandModel:
    return HandModel.open()


@pytest.fixture(scope="session")
def anatomy(model) -> Anatomy:
    return Anatomy.of(model)


@pytest.fixture(scope="session")
def hand(model, anatomy) -> GraspHand:
    return GraspHand(model, anatomy, torch.zeros(10))
