from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch
import trimesh

from grabnet.geometry.mesh import Mesh
from grabnet.grasping.grasp_hand import GraspPose
from grabnet.open.grasps.stability import StabilityConfig, cut, displacement, holds
from grabnet.physics.hand_pieces import hand_pieces
from grabnet.physics.simulation import RigidBody

CONFIG = StabilityConfig()


def block(centre, half) -> np.ndarray:
    return np.array(centre) + np.array(list(product((-1, 1), repeat=3))) * half


def cube(side: float = 0.04) -> RigidBody:
    box = trimesh.creation.box((side,) * 3)
    return cut(Mesh(box.vertices, box.faces), np.full(8, 0.01), CONFIG)


def test_a_closed_cage_holds():
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    cage = [block(0.0245 * axis, np.where(axis == 0, 0.02, 0.005)) for axis in axes]
    assert holds(cube(), cage, CONFIG)


def test_the_open_hand_beside_an_object_drops_it(hand):
    flat = hand.posed(GraspPose(torch.eye(3)[None], hand.joints[:1], torch.zeros(1, 21))).vertices[0].numpy()
    solids = [flat[piece] for piece in hand_pieces(hand.weights.numpy(), hand.rest.numpy())]
    beside = [solid + np.array([0.0, 0.06, 0.0]) for solid in solids]
    moved, _ = displacement(cube(), beside, CONFIG)
    assert moved >= CONFIG.max_displacement


def test_free_fall_follows_gravity():
    far = [block((1, 1, 1), 0.01)]
    slow = replace(CONFIG, max_displacement=10.0, duration=0.3)
    moved, turned = displacement(cube(), far, slow)
    assert moved == pytest.approx(9.81 * 0.3**2 / 2, rel=0.05)
    assert turned == pytest.approx(0, abs=1e-6)


def test_two_fingers_hold_by_friction_alone():
    pinch = [block((side * 0.0245, 0, 0), (0.005, 0.008, 0.008)) for side in (-1, 1)]
    assert holds(cube(), pinch, CONFIG)
    assert not holds(cube(), pinch, replace(CONFIG, friction=0.01))


def test_what_cannot_be_simulated_does_not_hold():
    assert displacement(cube(), [np.zeros((4, 3))], CONFIG) == (np.inf, np.inf)


def test_cells_follow_a_torus_and_leave_its_hole_open():
    ring = trimesh.creation.torus(0.04, 0.008, major_sections=96, minor_sections=32)
    rigid = cut(Mesh(ring.vertices, ring.faces), np.full(len(ring.vertices), 0.006), CONFIG)
    assert len(rigid.pieces) > 10
    corners = np.concatenate(rigid.pieces)
    reach = np.linalg.norm(corners[:, :2], axis=1)
    assert reach.min() > 0.0315 and reach.max() < 0.0485
    near = rigid.near(np.array([[0.05, 0.0, 0.0]]), 0.004)
    assert 0 < len(near.pieces) < len(rigid.pieces) / 4


def test_inertia_of_a_ball_is_two_fifths():
    sphere = trimesh.creation.icosphere(4, 0.03)
    rigid = cut(Mesh(sphere.vertices, sphere.faces), np.full(len(sphere.vertices), 0.01), CONFIG)
    np.testing.assert_allclose(rigid.inertia, 0.4 * 0.03**2 * np.eye(3), atol=0.02 * 0.4 * 0.03**2)
    np.testing.assert_allclose(rigid.centre, 0, atol=1e-6)
