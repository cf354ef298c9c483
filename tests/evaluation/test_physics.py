"""Simulated grasps against closed forms, symmetry, and hands that must hold or can't."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hydra.utils import instantiate
from omegaconf import OmegaConf
from scipy.spatial.transform import Rotation

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.errors import UserError
from grabnet.evaluation.physics import Outcome, PhysicsConfig, Simulator
from grabnet.evaluation.simulation import RigidBody, Simulation, SimulationError
from grabnet.geometry.mesh import Mesh
from grabnet.open.grasps.store import load_open_grasps
from grabnet.open.objects import build_object

pytest.importorskip("mujoco")
pytest.importorskip("coacd")

ROOT = Path(__file__).parents[2]
CONFIG: PhysicsConfig = instantiate(OmegaConf.load(ROOT / "configs/evaluation/physics.yaml"))
GRASPTTA = CONFIG.grasptta
DOWN = np.array([0.0, 0.0, -GRASPTTA.gravity])
# Free fall for 35 steps by semi-implicit Euler: h² g (1 + 2 + … + 35).
FALL = GRASPTTA.gravity / 240**2 * 35 * 36 / 2


def block(centre, half) -> np.ndarray:
    return np.array(centre) + np.array(list(product((-1, 1), repeat=3))) * half


def let_go(solids, dynamics=GRASPTTA.dynamics, gravity=DOWN, steps=35, body=None) -> float:
    body = body or RigidBody.of_pieces([block((0, 0, 0), 0.02)])
    return Simulation(body, solids, dynamics).let_go(gravity, steps).displacement


def plates(gap: float = -0.0005) -> list[np.ndarray]:
    """Either side of the block; a negative gap presses."""
    return [block((side * (0.03 + gap), 0, 0), 0.01) for side in (-1, 1)]


def test_what_nothing_holds_falls_as_euler_says():
    far = [block((1, 1, 1), 0.01)]
    assert let_go(far) == pytest.approx(FALL, rel=1e-9)
    assert pytest.approx(0.1073, abs=1e-4) == FALL
    assert let_go(far, gravity=[0, GRASPTTA.gravity, 0]) == pytest.approx(FALL, rel=1e-9)


def test_a_block_on_a_table_stays_and_falls_when_gravity_points_elsewhere():
    table = [block((0, 0, -0.03), (0.05, 0.05, 0.01))]
    assert let_go(table) < 3e-4
    assert let_go(table, gravity=-DOWN) == pytest.approx(FALL, rel=1e-6)


@pytest.mark.parametrize("friction", [0.3, 1.0])
def test_a_block_on_a_slope_slides_only_beyond_the_friction_cone(friction):
    """Gravity turned by an angle from the table's normal: held below atan μ; beyond, g (sin - μ cos) accelerates it."""
    table = [block((0, 0, -0.03), (1, 1, 0.01))]
    dynamics = replace(GRASPTTA.dynamics, friction=friction)
    flat = RigidBody.of_pieces([block((0, 0, -0.0185), (0.02, 0.02, 0.0015))])  # so flat that it can't tip over
    for share, slides in ((0.8, False), (1.4, True)):
        angle = share * np.arctan(friction)
        gravity = GRASPTTA.gravity * np.array([np.sin(angle), 0, -np.cos(angle)])
        moved = let_go(table, dynamics, gravity, 60, flat)
        along = GRASPTTA.gravity * (np.sin(angle) - friction * np.cos(angle))
        expected = along / 240**2 * 60 * 61 / 2
        assert moved == pytest.approx(expected, rel=0.1) if slides else moved < 1e-3


def test_plates_hold_by_friction_and_let_slip_without():
    assert let_go(plates()) < 1e-3
    assert let_go(plates(), replace(GRASPTTA.dynamics, friction=1e-4)) > 0.9 * FALL
    assert let_go(plates(gap=0.001)) == pytest.approx(FALL, rel=1e-6)  # they don't reach it


def test_a_closed_cage_holds_from_all_sides_though_it_is_slippery():
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    cage = [block(0.0302 * axis, np.where(axis == 0, 0.02, 0.01)) for axis in axes]
    slippery = replace(CONFIG.shake.dynamics, friction=1e-3)
    for axis in axes:
        assert let_go(cage, slippery, CONFIG.shake.gravity * axis, CONFIG.shake.steps) < 1e-3


def test_the_object_s_mass_is_of_no_influence():
    heavy = replace(GRASPTTA.dynamics, mass=10.0, friction=0.3)
    assert let_go(plates(-0.0001), heavy) == pytest.approx(let_go(plates(-0.0001), replace(heavy, mass=0.1)), rel=1e-3)


def test_an_object_deep_in_a_solid_is_thrown_out():
    inside = [block((0.01, 0, 0), 0.02)]
    assert 0.02 < let_go(inside, gravity=np.zeros(3), steps=240) < np.inf


def test_two_blocks_weigh_like_the_box_they_make():
    halves = RigidBody.of_pieces([block((side * 0.02, 0, 0.01), (0.02, 0.01, 0.03)) for side in (-1, 1)])
    np.testing.assert_allclose(halves.centre, (0, 0, 0.01), atol=1e-12)
    x, y, z = 0.08, 0.02, 0.06
    np.testing.assert_allclose(halves.inertia, np.diag([y * y + z * z, x * x + z * z, x * x + y * y]) / 12, atol=1e-12)


def test_diverging_numbers_and_unusable_solids_are_failures(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SimulationError, match=r"QACC|QVEL|QPOS"):
        let_go(plates(), gravity=1e12 * DOWN)
    for solid in (np.zeros((4, 3)), np.full((4, 3), np.nan), np.eye(3)):
        with pytest.raises(SimulationError):
            let_go([solid])
    assert not list(tmp_path.iterdir())  # no log that nobody asked for


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
    expected = let_go(solids, heavy, body=simulator.body)
    assert changed.let_go(DOWN, 35).displacement == pytest.approx(expected, rel=1e-6)


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
