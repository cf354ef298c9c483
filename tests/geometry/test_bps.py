import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.stats import kstest

from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.bps import BPS
from grabnet.geometry.placed import PlacedObjects
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.rotations import random_rotations
from grabnet.geometry.sdf_grid import SDFGrid
from tests.geometry.shapes import box, capsule, torus


def test_the_basis_is_even_in_its_ball():
    basis = BPS(20_000, radius=0.15, seed=3).basis.double().numpy()
    distance = np.linalg.norm(basis, axis=1)
    assert distance.max() <= 0.15
    assert kstest((distance / 0.15) ** 3, "uniform").pvalue > 0.01  # share of the volume within
    for axis in range(3):
        assert kstest(basis[:, axis] / distance, "uniform", args=(-1, 2)).pvalue > 0.01  # Archimedes' hat box


def test_the_basis_follows_from_its_seed():
    assert torch.equal(BPS(seed=1).basis, BPS(seed=1).basis)
    assert not torch.equal(BPS(seed=1).basis, BPS(seed=2).basis)
    # The very numbers: networks trained elsewhere hold for this basis.
    expected = torch.tensor([-0.09503046, -0.07105438, -0.07611681])
    torch.testing.assert_close(BPS().basis[0], expected, atol=1e-7, rtol=0)


def test_basis_travels_with_the_weights():
    assert list(BPS(8).state_dict()) == ["basis"]


def test_neighbours_in_the_basis_are_neighbours_in_space():
    basis = BPS().basis
    step = (basis[1:] - basis[:-1]).norm(dim=1)
    shuffled = basis[torch.randperm(len(basis), generator=torch.Generator().manual_seed(0))]
    assert step.median() < 0.2 * (shuffled[1:] - shuffled[:-1]).norm(dim=1).median()


@settings(deadline=None, max_examples=20)
@given(
    seed=st.integers(0, 2**31), batch=st.integers(1, 4), n=st.integers(1, 60), chunk=st.sampled_from([1, 999, 10**7])
)
def test_encoding_agrees_with_brute_force(seed, batch, n, chunk):
    bps = BPS(50, seed=seed)
    cloud = 0.1 * torch.randn(batch, n, 3, generator=torch.Generator().manual_seed(seed))
    found = bps.encode(cloud, feature_type=["dists", "deltas", "closest"], chunk=chunk)
    offsets = cloud[:, None].double() - bps.basis[:, None].double()
    nearest = offsets.norm(dim=-1).min(-1)
    torch.testing.assert_close(found["dists"], nearest.values.float(), atol=1e-7, rtol=1e-6)
    torch.testing.assert_close(found["deltas"].norm(dim=-1), found["dists"])
    torch.testing.assert_close(found["closest"] - bps.basis, found["deltas"])
    in_cloud = (found["closest"][:, :, None] == cloud[:, None]).all(-1).any(-1)
    assert in_cloud.all()


def test_encoding_agrees_with_a_kd_tree_far_from_the_origin():
    """Where the usual trick |a|² - 2ab + |b|² loses the small differences that matter."""
    bps = BPS(500)
    cloud = bps.basis[None] + 30 + 0.01 * torch.randn(1, 500, 3, generator=torch.Generator().manual_seed(0))
    expected, _ = cKDTree(cloud[0].double().numpy()).query(bps.basis.double().numpy())
    np.testing.assert_allclose(bps.encode(cloud)["dists"][0], expected, rtol=1e-6)


def test_encoding_takes_a_single_cloud_and_gives_what_is_asked_for():
    cloud = torch.randn(30, 3)
    assert {k: v.shape for k, v in BPS(7).encode(cloud, ["deltas"]).items()} == {"deltas": (1, 7, 3)}
    with pytest.raises(ValueError, match="choose from"):
        BPS(7).encode(cloud, ["distances"])


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**31))
def test_exact_features_turn_with_basis_and_object_together(seed):
    """The feature of an object turned by R equals that of the object at rest in the basis turned back by R."""
    bps, mesh = BPS(200), torus()
    rotation = random_rotations(1, torch.Generator().manual_seed(seed))[0]
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    turned = mesh.transformed(matrix)
    centroid = torch.tensor(mesh.centroid)
    expected = MeshQuery(turned).closest(bps.basis + rotation @ centroid).distance
    torch.testing.assert_close(bps.from_mesh(MeshQuery(mesh), rotation, centroid), expected, atol=3e-7, rtol=0)


def test_features_from_the_atlas_agree_with_exact_ones():
    meshes = [torus(), box((0.25, 0.03, 0.02)), capsule()]
    atlas = SDFAtlas([SDFGrid.build(mesh) for mesh in meshes])
    bps = BPS()
    objects = torch.tensor([2, 0, 1, 1, 0, 2])
    rotations = random_rotations(6, torch.Generator().manual_seed(0))
    centroids = torch.tensor(np.stack([meshes[o].centroid for o in objects]))
    found = PlacedObjects(atlas, objects, rotations, centroids).basis_distances(bps.basis)
    queries = [MeshQuery(mesh) for mesh in meshes]
    exact = torch.stack([bps.from_mesh(queries[o], rotations[i], centroids[i]) for i, o in enumerate(objects)])
    error = (found - exact).abs()
    assert error.mean() < 1e-4
    assert error.flatten().quantile(0.99) < 5e-4
    # Against the field's own definition, the nearest of many surface samples, which can only be longer.
    points = torch.tensor(meshes[2].sample_surface(20_000, 0)[0]) - centroids[0]
    sampled = bps.encode((points @ rotations[0].mT)[None])["dists"][0]
    assert (sampled - exact[0]).min() > -1e-6
    assert (sampled - found[0]).abs().mean() < 3e-4
