from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.optimize import nnls

from grabnet.geometry.rotations import random_rotations
from grabnet.grasping.forces import ForceConfig, HeldForces, across, solved, wrenches

from .test_terms import PINCH, pads

CONFIG = ForceConfig(iterations=2000, effort=0.01)
CENTRE = torch.zeros(1, 3)


def unmet(*arguments: list, config: ForceConfig = CONFIG) -> float:
    found = pads(*arguments)
    forces = HeldForces(torch.zeros(1, 3), found.place.shape[1], config)
    return float(forces.unmet(found, CENTRE, solve=True))


def test_a_pinch_holds_and_fingers_on_one_side_do_not():
    three = [[-0.02, 0.0, 0], [0.02, 0.01, 0.01], [0.02, -0.01, -0.01]], [[-1.0, 0, 0], [1, 0, 0], [1, 0, 0]]
    assert unmet(*three, [0.0] * 3) < 0.05
    assert unmet(*PINCH, [0.0, 0.0]) < 0.05
    beside = [[-0.02, 0.0, 0], [-0.02, 0.01, 0]], [[-1.0, 0, 0]] * 2
    assert unmet(*beside, [0.0, 0.0]) > 0.5


def test_without_friction_a_pinch_slips():
    slippery = ForceConfig(friction=0.01, iterations=2000, effort=0.01)
    assert unmet(*PINCH, [0.0, 0.0], config=slippery) > 0.6


def test_far_pads_do_not_hold_and_pressing_in_is_not_rewarded():
    assert unmet(*PINCH, [15.0, 15.0]) > unmet(*PINCH, [1.0, 1.0]) > unmet(*PINCH, [0.0, 0.0])
    assert unmet(*PINCH, [-5.0, -5.0]) == unmet(*PINCH, [0.0, 0.0])


def test_an_object_held_far_from_its_weight_turns():
    aside = torch.tensor([[0.0, 0.2, 0.0]])
    forces = HeldForces(torch.zeros(1, 3), 2, CONFIG)
    assert float(forces.unmet(pads(*PINCH, [0.0, 0.0]), aside, solve=True)) > 0.2


def test_forces_are_those_of_non_negative_least_squares():
    generator = torch.Generator().manual_seed(0)
    places = 0.03 * torch.randn(5, 3, generator=generator)
    found = pads(places.tolist(), places.tolist(), [0.0, 0.5, 1.0, -1.0, 3.0])
    matrix = wrenches(found, CENTRE, CONFIG)
    load = torch.eye(6)
    ours = solved(matrix, load, torch.zeros(1, 20, 6), CONFIG)[0]
    damped = np.concatenate([matrix[0].numpy(), math.sqrt(CONFIG.effort) * np.eye(20)])
    for column in range(6):
        exact, _ = nnls(damped, np.concatenate([load[:, column].numpy(), np.zeros(20)]))
        torch.testing.assert_close(ours[:, column], torch.from_numpy(exact).float(), atol=2e-2, rtol=0)


@pytest.mark.parametrize("axis", range(3))
def test_tangents_are_perpendicular(axis):
    normals = torch.cat([random_rotations(20, torch.Generator().manual_seed(0))[:, axis], torch.eye(3), -torch.eye(3)])
    frame = torch.stack([normals, *across(normals)], 1)
    torch.testing.assert_close(frame @ frame.mT, torch.eye(3).expand(len(frame), 3, 3), atol=1e-5, rtol=0)
