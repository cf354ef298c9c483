"""Nearest neighbours against a KD-tree, signs against a sphere's closed form."""

import torch
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from grabnet.geometry.nearest import nearest, signed_offset


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**31), batch=st.integers(1, 4), q=st.integers(1, 40), n=st.integers(1, 60))
def test_agrees_with_a_tree(seed, batch, q, n):
    generator = torch.Generator().manual_seed(seed)
    queries = torch.randn(batch, q, 3, generator=generator, dtype=torch.float64)
    points = torch.randn(batch, n, 3, generator=generator, dtype=torch.float64)
    found = nearest(queries, points)
    for k in range(batch):
        expected, _ = cKDTree(points[k].numpy()).query(queries[k].numpy())
        torch.testing.assert_close((queries[k] - points[k][found[k]]).norm(dim=-1), torch.from_numpy(expected))


def test_sign_and_size_on_a_sphere():
    ball = trimesh.creation.icosphere(4, 1.0)
    points = torch.tensor(ball.vertices).unsqueeze(0)
    queries = torch.randn(1, 200, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    offset = signed_offset(queries, points, points)
    true = queries.norm(dim=-1) - 1
    far = true.abs() > 0.1  # nearer, the spacing of the vertices shows
    assert torch.equal(offset.sign()[far], true.sign()[far])
    assert (offset - true)[far].abs().max() < 0.02


def test_gradient_is_finite_everywhere_and_exact_off_the_points():
    queries = torch.randn(2, 5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    points = torch.randn(2, 9, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2)).requires_grad_()
    normals = torch.nn.functional.normalize(points.detach(), dim=-1)
    assert torch.autograd.gradcheck(lambda p: signed_offset(queries, p, normals), points)
    signed_offset(points.detach(), points, normals).sum().backward()
    assert points.grad.isfinite().all()
