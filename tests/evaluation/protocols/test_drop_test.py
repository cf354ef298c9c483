"""Simulated grasps against closed forms, symmetry, and hands that must hold or can't."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hydra.utils import instantiate
from omegaconf import OmegaConf
from scipy.spatial.transform import Rotation

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.cli.entry import CONFIGS
from grabnet.errors import UserError
from grabnet.evaluation.protocols.drop_test import Outcome, PhysicsConfig, Simulator
from grabnet.geometry.mesh import Mesh
from grabnet.open.grasps.store import load_open_grasps
from grabnet.open.objects import build_object
from grabnet.physics.simulation import Simulation

CONFIG: PhysicsConfig = instantiate(OmegaConf.load(CONFIGS / "evaluate.yaml").physics)
GRASPTTA = CONFIG.grasptta
# Free fall for 35 steps by semi-implicit Euler: h² g (1 + 2 + … + 35).
FALL = GRASPTTA.gravity / 240**2 * 35 * 36 / 2


@pytest.fixture(scope="module")
def ball() -> Mesh:
    return build_object("spheremedium")


@pytest.fixture(scope="module")
def simulator(ball: Mesh, hand: HandModel, cache_dir: Path) -> Simulator:
    return Simulator(ball, hand, CONFIG, cache_dir)


@pytest.fixture(scope="module")
def grasps(hand: HandModel) -> np.ndarray:
    """(4, V, 3) of the shipped grasps of the ball."""
    shipped = load_open_grasps()
    index = (shipped.object == shipped.objects.index("spheremedium")).nonzero().squeeze(1)[::50][:4]
    shapes = hand.shaped(shipped.betas)[shipped.subject[index]]
    return hand(shipped.parameters(Anatomy.of(hand), index), shapes).vertices.numpy()


def distances(outcomes: list[Outcome]) -> np.ndarray:
    return np.array([outcome.displacement_cm for outcome in outcomes])


def test_grasps_hold_and_hands_half_a_metre_away_let_it_fall(simulator, grasps):
    assert (distances(simulator.grasptta(grasps)) < 1).all()
    away = simulator.grasptta(grasps + np.float32(0.5))
    np.testing.assert_allclose(distances(away), 100 * FALL, rtol=1e-6)
    assert {outcome.success for outcome in away} == {None}


def test_an_open_hand_under_the_ball_does_not_hold_it_from_all_sides(simulator, grasps, ball, hand):
    flat = hand.v_template.numpy()
    palm_up = (flat - flat.mean(0)) * np.array([1, -1, -1]) + ball.centroid
    below = palm_up - np.array([0, 0, palm_up[:, 2].max() - ball.bounds[0, 2]])
    held, dropped, away = simulator.shake(np.stack([grasps[0], below, grasps[0] + 0.5]).astype(np.float32))
    assert held.success and held.displacement_cm < 100 * CONFIG.shake.limit
    for outcome in (dropped, away):
        assert outcome.success is False and outcome.failure is None
        assert outcome.displacement_cm >= 100 * CONFIG.shake.limit


def test_neither_order_nor_number_of_grasps_matters(simulator, grasps):
    together = simulator.grasptta(grasps)
    assert simulator.grasptta(grasps[::-1]) == together[::-1]
    assert [simulator.grasptta(grasp[None])[0] for grasp in grasps] == together
    assert simulator.shake(grasps[1:2]) == simulator.shake(grasps[:2])[1:]


def test_both_protocols_in_one_scene_are_each_by_itself(simulator, grasps):
    """To the bit, though friction is changed between them; so is mass, to a thousandth: its inverse is kept, too."""
    apart = zip(simulator.grasptta(grasps), simulator.shake(grasps), strict=True)
    assert [tuple(pair) for pair in simulator.both(grasps)] == list(apart)
    solids = [grasps[0][piece] for piece in simulator.pieces]
    heavy = replace(CONFIG.shake.dynamics, mass=3.0, friction=0.2, timestep=1 / 500)
    changed = Simulation(simulator.body, solids, GRASPTTA.dynamics)
    changed.dynamics = heavy
    built = Simulation(simulator.body, solids, heavy)
    down = np.array([0, 0, -GRASPTTA.gravity])
    assert changed.let_go(down, 35).displacement == pytest.approx(built.let_go(down, 35).displacement, rel=1e-6)


def test_mirrored_and_turned_scenes_agree(simulator, grasps, ball, cache_dir):
    expected = distances(simulator.grasptta(grasps))
    mirror = np.array([-1, 1, 1], np.float32)
    mirrored = Simulator(Mesh(ball.vertices * mirror, ball.faces[:, ::-1]), HandModel.open("left"), CONFIG, cache_dir)
    np.testing.assert_allclose(distances(mirrored.grasptta(grasps * mirror)), expected, rtol=0.25, atol=0.02)
    rotation = Rotation.from_rotvec([0.4, -1.0, 0.7]).as_matrix().astype(np.float32)
    turned = Simulator(Mesh(ball.vertices @ rotation.T, ball.faces), HandModel.open(), CONFIG, cache_dir)
    found = distances(turned.grasptta(grasps @ rotation.T, rotation[:, 2]))
    np.testing.assert_allclose(found, expected, rtol=0.25, atol=0.02)


def test_a_hand_that_cannot_be_simulated_is_a_failure_and_the_others_are_not(simulator, grasps):
    broken = np.stack([grasps[0], np.full_like(grasps[0], np.nan), np.zeros_like(grasps[0]), grasps[1]])
    outcomes = simulator.grasptta(broken)
    assert [outcomes[0], outcomes[3]] == simulator.grasptta(grasps[:2])
    for outcome in outcomes[1:3]:
        assert outcome.displacement_cm is None and outcome.success is None
        assert outcome.failure and "\n" not in outcome.failure


def test_a_hand_of_a_hundredth_of_the_size_lets_it_fall(simulator, grasps):
    (outcome,) = simulator.grasptta(0.01 * grasps[:1] + np.float32(0.2))
    assert outcome.displacement_cm == pytest.approx(100 * FALL, rel=1e-6)


def test_hands_of_another_topology_are_refused_in_one_sentence(simulator):
    with pytest.raises(UserError, match=r"must be the 778 of the hand model"):
        simulator.shake(np.zeros((1, 100, 3), np.float32))


@pytest.mark.parametrize("name", ["friction", "steps", "limit"])
def test_constants_are_checked(name):
    with pytest.raises(UserError, match=name):
        replace(CONFIG.shake, **{name: 0})
