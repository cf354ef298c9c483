"""Rigid bodies among fixed solids, against closed forms."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from grabnet.physics.simulation import Dynamics, RigidBody, Simulation, SimulationError

STANDARD = Dynamics(friction=3.0, mass=1.0, timestep=1 / 240)
GRAVITY = 9.81
DOWN = np.array([0.0, 0.0, -GRAVITY])
# Free fall for 35 steps by semi-implicit Euler: h² g (1 + 2 + … + 35).
FALL = GRAVITY / 240**2 * 35 * 36 / 2


def block(centre, half) -> np.ndarray:
    return np.array(centre) + np.array(list(product((-1, 1), repeat=3))) * half


def let_go(solids, dynamics=STANDARD, gravity=DOWN, steps=35, body=None) -> float:
    body = body or RigidBody.of_pieces([block((0, 0, 0), 0.02)])
    return Simulation(body, solids, dynamics).let_go(gravity, steps).displacement


def plates(gap: float = -0.0005) -> list[np.ndarray]:
    """Either side of the block; a negative gap presses."""
    return [block((side * (0.03 + gap), 0, 0), 0.01) for side in (-1, 1)]


def test_what_nothing_holds_falls_as_euler_says():
    far = [block((1, 1, 1), 0.01)]
    assert let_go(far) == pytest.approx(FALL, rel=1e-9)
    assert pytest.approx(0.1073, abs=1e-4) == FALL
    assert let_go(far, gravity=[0, GRAVITY, 0]) == pytest.approx(FALL, rel=1e-9)


def test_a_block_on_a_table_stays_and_falls_when_gravity_points_elsewhere():
    table = [block((0, 0, -0.03), (0.05, 0.05, 0.01))]
    assert let_go(table) < 3e-4
    assert let_go(table, gravity=-DOWN) == pytest.approx(FALL, rel=1e-6)


@pytest.mark.parametrize("friction", [0.3, 1.0])
def test_a_block_on_a_slope_slides_only_beyond_the_friction_cone(friction):
    """Gravity turned by an angle from the table's normal: held below atan μ; beyond, g (sin - μ cos) accelerates it."""
    table = [block((0, 0, -0.03), (1, 1, 0.01))]
    dynamics = replace(STANDARD, friction=friction)
    flat = RigidBody.of_pieces([block((0, 0, -0.0185), (0.02, 0.02, 0.0015))])  # so flat that it can't tip over
    for share, slides in ((0.8, False), (1.4, True)):
        angle = share * np.arctan(friction)
        gravity = GRAVITY * np.array([np.sin(angle), 0, -np.cos(angle)])
        moved = let_go(table, dynamics, gravity, 60, flat)
        along = GRAVITY * (np.sin(angle) - friction * np.cos(angle))
        expected = along / 240**2 * 60 * 61 / 2
        assert moved == pytest.approx(expected, rel=0.1) if slides else moved < 1e-3


def test_plates_hold_by_friction_and_let_slip_without():
    assert let_go(plates()) < 1e-3
    assert let_go(plates(), replace(STANDARD, friction=1e-4)) > 0.9 * FALL
    assert let_go(plates(gap=0.001)) == pytest.approx(FALL, rel=1e-6)  # they don't reach it


def test_a_closed_cage_holds_from_all_sides_though_it_is_slippery():
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    cage = [block(0.0302 * axis, np.where(axis == 0, 0.02, 0.01)) for axis in axes]
    slippery = replace(STANDARD, friction=1e-3)
    for axis in axes:
        assert let_go(cage, slippery, GRAVITY * axis, 240) < 1e-3


def test_the_object_s_mass_is_of_no_influence():
    heavy = replace(STANDARD, mass=10.0, friction=0.3)
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
