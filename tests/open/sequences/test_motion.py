"""Smooth ways from pose to pose."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from grabnet.open.sequences.motion import Pose, between, minimum_jerk, ramp, travel


def random_pose(seed):
    rng = np.random.default_rng(seed)
    return Pose(Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3))


def test_poses_compose_as_matrices_do():
    a, b = random_pose(0), random_pose(1)

    def matrix(pose):
        return np.block([[pose.rotation, pose.position[:, None]], [np.zeros(3), 1]])

    np.testing.assert_allclose(matrix(a @ b), matrix(a) @ matrix(b), atol=1e-12)
    np.testing.assert_allclose(matrix(a.inverse()), np.linalg.inv(matrix(a)), atol=1e-12)
    points = np.random.default_rng(2).normal(size=(5, 3))
    np.testing.assert_allclose((a @ b).points(points), a.points(b.points(points)), atol=1e-12)


def test_minimum_jerk_starts_and_ends_at_rest():
    time = np.linspace(-0.2, 1.2, 2801)
    way = minimum_jerk(time)
    speed, acceleration = np.gradient(way, time), np.gradient(np.gradient(way, time), time)
    assert way[0] == 0 and way[-1] == 1 and (np.diff(way) >= 0).all()
    assert speed.max() < 1.8751
    assert np.abs(acceleration[np.abs(time) < 0.003]).max() < 0.5, "no jolt at the start"


def test_travel_arrives_and_rises_first_when_it_leaves():
    start, end = random_pose(3), random_pose(4)
    end = Pose(end.rotation, start.position + np.array([0.3, 0.2, 0.1]))
    for rise in ("", "leave", "land"):
        path = travel(start, end, 60, rise)
        np.testing.assert_allclose(path.rotation[-1], end.rotation, atol=1e-9)
        np.testing.assert_allclose(path.position[-1], end.position, atol=1e-12)
    up = travel(start, end, 100, "leave").position - start.position
    assert up[24, 1] > 0.03 and np.abs(up[24, [0, 2]]).max() < 1e-9
    down = travel(start, end, 100, "land").position - start.position
    assert np.abs(down[24, 1]) < 1e-9 and down[24, 0] > 0.05


def test_rotations_turn_about_one_axis():
    start, end = Rotation.random(random_state=5).as_matrix(), Rotation.random(random_state=6).as_matrix()
    half = between(start, end, np.array([0.5]))[0]
    np.testing.assert_allclose(start.T @ half, half.T @ end, atol=1e-9)


def test_ramps_end_where_they_should():
    np.testing.assert_allclose(ramp(np.array([0.0, 1]), np.array([2.0, -1]), 10)[-1], [2, -1])
