import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.sdf_grid import AtlasConfig, SDFGrid
from tests.geometry.shapes import CLOSED_FORMS, cup

NAMES = [*CLOSED_FORMS, "cup"]
MESHES = [build() for build, _ in CLOSED_FORMS.values()] + [cup()]


@pytest.fixture(scope="module")
def atlas() -> SDFAtlas:
    config = AtlasConfig(fine_nodes=64**3, coarse_nodes=48**3)
    return SDFAtlas([SDFGrid.build(mesh, config) for mesh in MESHES])


def near(mesh: Mesh, n: int, spread: float, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    points = torch.tensor(mesh.sample_surface(n, seed)[0])
    return points + spread * torch.randn(n, 3, generator=generator)


def batch(n: int = 400, spread: float = 0.005, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Points around each object, in an order other than the atlas's, one object twice."""
    objects = torch.tensor([3, 0, 2, 1, 4, 0])
    return torch.stack([near(MESHES[o], n, spread, seed + i) for i, o in enumerate(objects)]), objects


def exact(points: torch.Tensor, objects: torch.Tensor) -> torch.Tensor:
    return torch.stack([MeshQuery(MESHES[o]).signed_distance(p) for p, o in zip(points, objects, strict=True)])


def far_apart(points: torch.Tensor, radius: float) -> torch.Tensor:
    return radius * torch.nn.functional.normalize(points, dim=-1)


@pytest.mark.parametrize("name", CLOSED_FORMS)
def test_full_size_lookup_near_the_surface_agrees_with_the_closed_form(name):
    build, truth = CLOSED_FORMS[name]
    mesh = build()
    points = near(mesh, 20_000, 0.003, 0)
    error = np.abs(SDFAtlas([SDFGrid.build(mesh)])(points[None], torch.tensor([0]))[0].numpy() - truth(points.numpy()))
    assert error.mean() < 2e-5
    assert np.quantile(error, 0.99) < 2e-4
    assert error.max() < 1e-3  # at edges, less than a voxel


@pytest.mark.parametrize(("spread", "mean", "p99"), [(0.003, 1e-4, 6e-4), (0.02, 1.5e-4, 1e-3), (0.06, 4e-4, 3e-3)])
def test_lookup_agrees_with_exact_queries(atlas, spread, mean, p99):
    points, objects = batch(2000, spread)
    closed = objects != NAMES.index("cup")  # the opening of a cup is another matter: see below
    error = (atlas(points, objects) - exact(points, objects)).abs()[closed]
    assert error.mean() < mean
    assert error.flatten().quantile(0.99) < p99


def test_the_wall_of_an_open_cup_separates_in_from_out(atlas):
    wall = near(MESHES[-1], 3000, 0, 0)
    wall = wall[(wall[:, :2].norm(dim=1) > 0.0395) & (wall[:, 2].abs() < 0.035)]
    outward = torch.nn.functional.normalize(wall * torch.tensor([1.0, 1, 0]), dim=1)
    cup_index = torch.tensor([NAMES.index("cup")])
    for offset in (-0.008, -0.004, 0.004, 0.008):
        found = atlas((wall + offset * outward)[None], cup_index)
        torch.testing.assert_close(found, torch.full_like(found, offset), atol=3e-4, rtol=0)


def test_beyond_the_coarse_box_distance_is_that_of_the_surface(atlas):
    points, objects = batch(500)
    for radius in (0.35, 0.6, 2.0):
        far = far_apart(points, radius)
        found, gradient = atlas.with_gradient(far, objects)
        queries = [MeshQuery(MESHES[o]).closest(p) for p, o in zip(far, objects, strict=True)]
        error = (found - torch.stack([q.distance for q in queries])).abs()
        assert error.mean() < 1e-3
        assert error.max() < 0.01
        true_gradient = torch.nn.functional.normalize(far - torch.stack([q.position for q in queries]), dim=-1)
        assert (gradient * true_gradient).sum(-1).min() > 0.98
        torch.testing.assert_close(gradient.norm(dim=-1), torch.ones(far.shape[:2]))


@pytest.mark.parametrize(("spread", "radius", "tolerance"), [(0.004, None, 1e-3), (0.0, 0.11, 1e-3), (0.0, 0.5, 0.05)])
def test_gradient_agrees_with_finite_differences(atlas, spread, radius, tolerance):
    """In the fine box, in the coarse box, and outside of both (where it is that of the true distance instead)."""
    points, objects = batch(300, spread)
    points = points if radius is None else far_apart(points, radius)
    points = points.requires_grad_()
    atlas(points, objects).sum().backward()
    step = 2e-5 if radius is None or radius < 0.3 else 2e-3
    numeric = torch.stack(
        [
            (atlas(points.detach() + step * axis, objects) - atlas(points.detach() - step * axis, objects)) / (2 * step)
            for axis in torch.eye(3)
        ],
        -1,
    )
    error = (points.grad - numeric).abs().amax(-1)
    # The interpolant has kinks between cells, where no difference can agree: a step reaches over one in 5 % of cases.
    assert error.flatten().quantile(0.8) < tolerance + 2e-3
    assert error.mean() < tolerance + 0.02


def test_gradient_is_the_outward_normal_at_the_surface(atlas):
    for name in ("sphere", "torus", "capsule"):
        index = NAMES.index(name)
        points, normals = (torch.tensor(x)[None] for x in MESHES[index].sample_surface(2000, 0))
        cosine = (atlas.with_gradient(points, torch.tensor([index]))[1] * normals).sum(-1)
        assert cosine.mean() > 0.995
        assert cosine.min() > 0.9


def test_gradient_weighs_by_what_arrives(atlas):
    points, objects = batch(50)
    weight = torch.randn(points.shape[:2], generator=torch.Generator().manual_seed(1))
    points.requires_grad_()
    distance, gradient = atlas.with_gradient(points, objects)
    (distance * weight).sum().backward()
    torch.testing.assert_close(points.grad, weight.unsqueeze(-1) * gradient)
    assert not gradient.requires_grad


def test_levels_meet_without_a_step(atlas):
    for index in range(len(MESHES)):
        low, high = atlas.fine_box[index]
        u = torch.rand(2000, 3, generator=torch.Generator().manual_seed(index))
        for axis in range(3):
            border = low + u * (high - low)
            border[:, axis] = high[axis]
            pair = border.repeat(2, 1, 1)
            pair[0, :, axis] -= 1e-6
            pair[1, :, axis] += 1e-6
            fine, coarse = atlas(pair, torch.full((2,), index))
            step = (fine - coarse).abs()
            if index == NAMES.index("cup"):  # the membrane may pass through the border
                step = step[fine * coarse > 0]
            assert step.mean() < 2.5e-4
            assert step.quantile(0.99) < 2e-3


def test_the_coarse_border_is_crossed_without_a_step(atlas):
    centre = atlas.origin[1::2] + atlas.spacing[1::2, None] * (atlas.dims[1::2] - 1) / 2
    half = atlas.spacing[1::2] * (atlas.dims[1::2, 0] - 1) / 2
    objects = torch.arange(len(MESHES))
    u = torch.rand(len(MESHES), 500, 2, generator=torch.Generator().manual_seed(0)) * 0.2 - 0.1
    x = half[:, None, None].expand(-1, 500, 1)
    ends = [torch.cat([x + shift, u], -1) + centre[:, None] for shift in (-1e-6, 1e-6)]
    torch.testing.assert_close(atlas(ends[0], objects), atlas(ends[1], objects), atol=2e-3, rtol=0)


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 2**31), scale=st.floats(1e-4, 5))
def test_distance_never_changes_faster_than_the_point(atlas, seed, scale):
    """1-Lipschitz, but for what trilinear interpolation, float16 and the level border add."""
    generator = torch.Generator().manual_seed(seed)
    a = 0.1 * torch.randn(4, 200, 3, generator=generator)
    b = a + 0.01 * scale * torch.randn(4, 200, 3, generator=generator)
    objects = torch.arange(4)
    change = (atlas(a, objects) - atlas(b, objects)).abs()
    assert (change <= 1.02 * (a - b).norm(dim=-1) + 4e-3).all()


def test_lookup_is_the_same_for_any_threads_dtype_and_layout(atlas):
    points, objects = batch(8000)
    threads = torch.get_num_threads()
    expected = atlas(points, objects)
    try:
        torch.set_num_threads(1 if threads > 1 else 3)
        assert torch.equal(atlas(points, objects), expected)
    finally:
        torch.set_num_threads(threads)
    strided = points.transpose(1, 2).contiguous().transpose(1, 2)
    assert torch.equal(atlas(strided, objects), expected)
    double = points.double().requires_grad_()
    assert atlas(double, objects).dtype == torch.float64
    atlas(double, objects).sum().backward()
    assert double.grad.dtype == torch.float64


def test_nan_and_infinity_read_nothing_outside(atlas):
    points = torch.tensor([[[torch.nan, 0, 0], [torch.inf, 0, 0], [0, -torch.inf, 1e30], [0, 0, 0.1]]])
    found = atlas(points, torch.tensor([0]))[0]
    assert found[0].isnan()
    assert not found[1].isfinite()
    assert not found[2].isfinite()
    torch.testing.assert_close(found[3], torch.tensor(0.06), atol=5e-4, rtol=0)


def test_wrong_shapes_are_refused(atlas):
    with pytest.raises(ValueError, match=r"points must be \(B, N, 3\)"):
        atlas(torch.zeros(5, 3), torch.tensor([0]))
    with pytest.raises(ValueError, match=r"points must be \(B, N, 3\)"):
        atlas(torch.zeros(2, 5, 3), torch.tensor([0]))
    assert atlas(torch.zeros(2, 0, 3), torch.tensor([0, 1])).shape == (2, 0)
    assert len(atlas) == len(MESHES)
