import numpy as np
import pytest
import torch
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.voxels import RayCrossings, Runs, inside


def voxels(runs: Runs) -> set[tuple[int, int, int]]:
    return {
        (int(i), int(j), k)
        for (i, j), first, last in zip(runs.column, runs.first, runs.last, strict=True)
        for k in range(first, last + 1)
    }


def of(mesh: trimesh.Trimesh, spacing: float, at_least: int = 1) -> Runs:
    return RayCrossings.of(mesh.vertices, mesh.faces, spacing).inside(at_least)


@settings(deadline=None, max_examples=12)
@given(st.integers(0, 2**31), st.floats(0.06, 0.3))
def test_the_same_voxels_as_asked_one_by_one(seed, spacing):
    """A knot of a torus and a box, anywhere: every centre of the box around, by the winding number of MeshQuery."""
    rng = np.random.default_rng(seed)
    thing = trimesh.util.concatenate(
        [trimesh.creation.torus(0.5, 0.2, 12, 10), trimesh.creation.box((0.9, 0.3, 0.4)).subdivide()]
    )
    thing.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
    thing.apply_translation(rng.normal(size=3))
    mesh = Mesh(thing.vertices, thing.faces)
    low, high = np.floor(mesh.bounds / spacing).astype(int)
    index = np.stack(np.meshgrid(*map(np.arange, low, high + 1), indexing="ij"), -1).reshape(-1, 3)
    distance = MeshQuery(mesh).signed_distance(torch.tensor((index + 0.5) * spacing, dtype=torch.float32)).numpy()
    found = voxels(RayCrossings.of(mesh.vertices, mesh.faces, spacing).inside())
    for voxel, d in zip(map(tuple, index.tolist()), distance, strict=True):
        if abs(d) > 1e-5:
            assert (voxel in found) == (d < 0)
    assert len(RayCrossings.of(mesh.vertices, mesh.faces, spacing).inside()) == len(found)
    turned = Mesh(mesh.vertices, mesh.faces[:, ::-1])
    assert voxels(RayCrossings.of(turned.vertices, turned.faces, spacing).inside()) == found


def test_faces_along_the_lines_and_through_the_centres():
    """A box whose faces pass exactly through voxel centres: half-open, so that it holds as many as its volume."""
    box = trimesh.creation.box((4, 6, 8)).subdivide().subdivide()
    assert len(of(box, 1.0)) == 4 * 6 * 8
    box.apply_translation((0.5, 0.5, 0.5))
    assert len(of(box, 1.0)) == 4 * 6 * 8


def test_two_balls_share_a_lens():
    r, d = 1.0, 1.1
    balls = [trimesh.creation.icosphere(4, r) for _ in range(2)]
    balls[1].apply_translation((0.3 * d, -0.5 * d, np.sqrt(1 - 0.34) * d))
    spacing = 0.02
    one, other = (of(ball, spacing) for ball in balls)
    lens = np.pi * (4 * r + d) * (2 * r - d) ** 2 / 12
    assert one.shared(other) * spacing**3 == pytest.approx(lens, rel=0.005)
    assert one.shared(other) == other.shared(one) == len(voxels(one) & voxels(other))
    assert one.shared(one) == len(one)
    # As one mesh, the lens is where it overlaps itself.
    together = trimesh.util.concatenate(balls)
    assert len(of(together, spacing, at_least=2)) == one.shared(other)
    assert len(of(together, spacing)) == len(one) + len(other) - one.shared(other)


def test_nothing_in_common():
    ball, far = trimesh.creation.icosphere(2), trimesh.creation.icosphere(2)
    far.apply_translation((0, 0, 5))
    assert of(ball, 0.1).shared(of(far, 0.1)) == of(far, 0.1).shared(of(ball, 0.1)) == 0
    speck = trimesh.creation.icosphere(2, 1e-4)
    speck.apply_translation((0.01, 0.01, 0.01))
    assert len(of(speck, 0.1)) == 0
    assert of(speck, 0.1).shared(of(ball, 0.1)) == of(ball, 0.1).shared(of(speck, 0.1)) == 0


def test_an_open_mesh_is_closed_as_by_a_membrane():
    ball = trimesh.creation.icosphere(3)
    bowl = Mesh(ball.vertices, ball.faces[ball.triangles_center[:, 2] < 0])
    assert not bowl.is_closed
    volume = len(inside(bowl, 0.05)) * 0.05**3
    assert 0.9 * 2 * np.pi / 3 < volume < 1.25 * 2 * np.pi / 3
    closed = Mesh(ball.vertices, ball.faces)
    assert voxels(inside(closed, 0.05)) == voxels(of(ball, 0.05))


def test_an_open_mesh_in_other_units_is_refused():
    ball = trimesh.creation.icosphere(1, 100.0)
    with pytest.raises(UserError, match="scale"):
        inside(Mesh(ball.vertices, ball.faces[1:]), 0.001)
