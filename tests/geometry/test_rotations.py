"""Rotation conversions against SciPy, and their gradients where the textbook formulas divide by zero."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from grabnet.geometry.rotations import (
    about_z,
    axis_angle_to_matrix,
    matrix_to_axis_angle,
    matrix_to_six_d,
    random_rotations,
    six_d_to_matrix,
)

AXES = torch.nn.functional.normalize(
    torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, 0, -1], [1, 1, 1], [-1, 0.3, 2]], dtype=torch.float64), dim=-1
)
coordinate = st.floats(-10, 10, allow_nan=False)


def vectors(n: int) -> st.SearchStrategy[list[float]]:
    return st.lists(coordinate, min_size=n, max_size=n)


@settings(deadline=None)
@given(vectors(3))
def test_axis_angle_agrees_with_scipy(vector):
    ours = axis_angle_to_matrix(torch.tensor(vector, dtype=torch.float64))
    np.testing.assert_allclose(ours, Rotation.from_rotvec(vector).as_matrix(), atol=1e-9)


@settings(deadline=None)
@given(vectors(3))
def test_axis_angle_survives_the_round_trip(vector):
    matrix = axis_angle_to_matrix(torch.tensor(vector, dtype=torch.float64))
    back = matrix_to_axis_angle(matrix)
    assert back.norm() <= math.pi + 1e-9
    # At π two vectors mean one rotation, so the matrices are compared.
    torch.testing.assert_close(axis_angle_to_matrix(back), matrix, atol=1e-7, rtol=0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("angle", [0.0, 1e-8, 1e-4, math.pi - 1e-6, math.pi])
def test_axis_angle_gradients_are_finite_at_zero_and_half_turns(angle, dtype):
    vector = (angle * AXES).to(dtype).requires_grad_()
    target = axis_angle_to_matrix(torch.tensor([0.3, -0.2, 0.9], dtype=dtype))
    (axis_angle_to_matrix(vector) - target).square().sum().backward()
    assert vector.grad.isfinite().all()
    assert vector.grad.abs().max() > 1e-3


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("angle", [0.0, 1e-8, 1e-4, math.pi - 1e-6, math.pi])
def test_logarithm_gradients_are_finite_at_zero_and_half_turns(angle, dtype):
    matrix = axis_angle_to_matrix((angle * AXES).to(dtype)).requires_grad_()
    matrix_to_axis_angle(matrix).square().sum().backward()
    assert matrix.grad.isfinite().all()


@pytest.mark.parametrize("angle", [0.0, 1e-3, 1.0, 3.0])
def test_axis_angle_gradients_against_finite_differences(angle):
    torch.autograd.gradcheck(axis_angle_to_matrix, (angle * AXES).requires_grad_(), atol=1e-6)


@settings(deadline=None)
@given(vectors(6))
def test_six_d_gives_rotations(numbers):
    six_d = torch.tensor(numbers, dtype=torch.float64)
    a, b = six_d.view(3, 2).unbind(-1)
    if a.norm() < 1e-3 or torch.linalg.cross(a, b).norm() < 1e-3 * a.norm():
        return  # degenerate: has its own test
    matrix = six_d_to_matrix(six_d)
    torch.testing.assert_close(matrix @ matrix.mT, torch.eye(3, dtype=torch.float64), atol=1e-6, rtol=0)
    assert torch.linalg.det(matrix) > 0
    # Gram–Schmidt: the first column keeps its direction, the second stays in the plane of both and on its side.
    torch.testing.assert_close(matrix[:, 0], a / a.norm())
    assert matrix[:, 1] @ b > 0
    assert abs(matrix[:, 2] @ b) < 1e-6


def test_six_d_inverts_and_keeps_any_batch_shape():
    matrix = random_rotations(24, torch.Generator().manual_seed(0)).view(2, 3, 4, 3, 3)
    six_d = matrix_to_six_d(matrix)
    assert six_d.shape == (2, 3, 4, 6)
    torch.testing.assert_close(six_d[..., 0], matrix[..., 0, 0])
    torch.testing.assert_close(six_d[..., 1], matrix[..., 0, 1])  # row-major: the two columns alternate
    torch.testing.assert_close(six_d_to_matrix(six_d), matrix)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    "six_d", [[0] * 6, [1, 1, 0, 0, 0, 0], [1, -3, 1, -3, 1, -3], [1e-20] * 6, [0, 1, 0, 2, 0, 3], [1, 0] * 3]
)
def test_degenerate_six_d_stays_finite(six_d, dtype):
    six_d = torch.tensor(six_d, dtype=dtype, requires_grad=True)
    matrix = six_d_to_matrix(six_d)
    matrix.sum().backward()
    assert matrix.isfinite().all()
    assert six_d.grad.isfinite().all()


def test_six_d_gradients_against_finite_differences():
    six_d = torch.randn(5, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64, requires_grad=True)
    torch.autograd.gradcheck(six_d_to_matrix, six_d)


def test_about_z_turns_x_towards_y():
    angle = torch.tensor([0.0, 0.7, -2.0, math.pi])
    expected = np.stack([Rotation.from_rotvec([0, 0, a]).as_matrix() for a in angle.tolist()])
    np.testing.assert_allclose(about_z(angle), expected, atol=1e-6)


def test_random_rotations_are_uniform_and_repeatable():
    rotations = random_rotations(20_000, torch.Generator().manual_seed(1), dtype=torch.float64)
    assert torch.equal(rotations, random_rotations(20_000, torch.Generator().manual_seed(1), dtype=torch.float64))
    torch.testing.assert_close(rotations @ rotations.mT, torch.eye(3, dtype=torch.float64).expand_as(rotations))
    assert (torch.linalg.det(rotations) > 0).all()
    # Over SO(3) every entry has mean 0 and variance 1/3, and the angle's density is (1 - cos θ)/π, of mean π/2 + 2/π.
    torch.testing.assert_close(rotations.mean(0), torch.zeros(3, 3, dtype=torch.float64), atol=0.02, rtol=0)
    torch.testing.assert_close(rotations.var(0), torch.full((3, 3), 1 / 3, dtype=torch.float64), atol=0.01, rtol=0)
    angle = matrix_to_axis_angle(rotations).norm(dim=-1)
    assert angle.mean().item() == pytest.approx(math.pi / 2 + 2 / math.pi, abs=0.02)
