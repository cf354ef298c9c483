from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.placed import PlacedObjects
from grabnet.geometry.rotations import random_rotations
from grabnet.geometry.sdf_grid import SDFGrid
from grabnet.training.acceleration import denormals_flushed
from tests.geometry.shapes import box, sphere

RADIUS, SIDES = 0.04, (0.05, 0.06, 0.08)


@pytest.fixture(scope="module")
def placed() -> PlacedObjects:
    meshes = [sphere(RADIUS), box(SIDES)]
    generator = torch.Generator().manual_seed(0)
    return PlacedObjects(
        atlas=SDFAtlas([SDFGrid.build(mesh) for mesh in meshes]),
        index=torch.tensor([1, 0, 1]),
        rotations=random_rotations(3, generator),
        centres=0.01 * torch.randn(3, 3, generator=generator),
    )


def closed_form(placed: PlacedObjects, points: torch.Tensor) -> np.ndarray:
    """Signed distances of world points (B, N, 3) to the ball and the box, each about its own origin."""
    own = (points @ placed.rotations + placed.centres.unsqueeze(1)).numpy()
    q = np.abs(own) - np.array(SIDES) / 2
    to_box = np.linalg.norm(q.clip(0), axis=-1) + q.max(-1).clip(None, 0)
    to_ball = np.linalg.norm(own, axis=-1) - RADIUS
    return np.where(placed.index.numpy()[:, None] == 0, to_ball, to_box)


def test_distances_are_those_of_the_turned_and_shifted_solids(placed):
    points = 0.05 * torch.randn(3, 40, 3, generator=torch.Generator().manual_seed(1))
    expected = closed_form(placed, points)
    assert (expected < -0.005).any() and (expected > 0.01).any()
    np.testing.assert_allclose(placed.distances(points), expected, atol=1e-3)
    assert torch.equal(placed.distances(points), placed.signed_distances(points))


def test_basis_distances_are_unsigned_and_shared_by_all_elements(placed):
    basis = 0.05 * torch.randn(60, 3, generator=torch.Generator().manual_seed(2))
    expected = np.abs(closed_form(placed, basis.expand(3, -1, -1)))
    np.testing.assert_allclose(placed.basis_distances(basis), expected, atol=2e-3)


def test_with_samples_distances_are_to_the_nearest_of_them(placed):
    generator = torch.Generator().manual_seed(3)
    samples = 0.04 * torch.randn(2, 200, 3, generator=generator)
    points = 0.05 * torch.randn(3, 30, 3, generator=generator)
    sampled = PlacedObjects(placed.atlas, placed.index, placed.rotations, placed.centres, samples)
    for k in range(3):
        tree = cKDTree((samples[placed.index[k]] @ placed.rotations[k].mT).numpy())
        np.testing.assert_allclose(sampled.distances(points)[k], tree.query(points[k].numpy())[0], atol=1e-6)
    assert torch.equal(sampled.signed_distances(points), placed.distances(points))


def test_selected_elements_keep_their_objects(placed):
    points = 0.05 * torch.randn(3, 10, 3, generator=torch.Generator().manual_seed(4))
    rows = torch.tensor([2, 0])
    torch.testing.assert_close(placed.select(rows).distances(points[rows]), placed.distances(points)[rows])


def test_with_basis_samples_basis_distances_are_to_the_nearest_of_them(placed):
    generator = torch.Generator().manual_seed(5)
    samples = 0.04 * torch.randn(2, 300, 3, generator=generator)
    basis = 0.05 * torch.randn(50, 3, generator=generator)
    sampled = replace(placed, basis_samples=samples)
    for k in range(3):
        tree = cKDTree((samples[placed.index[k]] @ placed.rotations[k].mT).numpy())
        np.testing.assert_allclose(sampled.basis_distances(basis)[k], tree.query(basis.numpy())[0], atol=1e-6)
    points = basis.expand(3, -1, -1)
    assert torch.equal(sampled.distances(points), placed.distances(points))


def test_distances_to_samples_pull_straight_to_the_nearest(placed):
    generator = torch.Generator().manual_seed(6)
    samples = 0.04 * torch.randn(2, 100, 3, generator=generator)
    points = (0.05 * torch.randn(3, 20, 3, generator=generator)).requires_grad_()
    distances = replace(placed, samples=samples).distances(points)
    (gradient,) = torch.autograd.grad(distances.sum(), points)
    for k in range(3):
        cloud = (samples[placed.index[k]] @ placed.rotations[k].mT).numpy()
        nearest = torch.from_numpy(cloud[cKDTree(cloud).query(points[k].detach().numpy())[1]])
        foot = points[k] - distances[k].unsqueeze(1) * gradient[k]
        torch.testing.assert_close(foot, nearest, atol=1e-6, rtol=0)


def test_points_that_are_not_finite_have_no_distance_to_samples(placed):
    points = torch.zeros(3, 2, 3)
    points[1, 0, 2], points[2, 1, 0] = torch.nan, torch.inf
    distances = replace(placed, samples=torch.ones(2, 5, 3)).distances(points)
    assert (distances.isfinite() == torch.tensor([[1, 1], [0, 1], [1, 0]], dtype=torch.bool)).all()


def test_flushed_denormals_do_not_matter(placed):
    """As in a training: the number after 0 is then 0."""
    disc = 0.03 * torch.randn(2, 400, 3, generator=torch.Generator().manual_seed(7))
    disc[..., 2] = torch.where(torch.arange(400) % 3 > 0, 0.0, disc[..., 2].abs())
    points = 0.05 * torch.randn(3, 30, 3, generator=torch.Generator().manual_seed(8))
    expected = replace(placed, samples=disc).distances(points)
    with denormals_flushed():
        torch.testing.assert_close(replace(placed, samples=disc).distances(points), expected)
