"""Crossings of two surfaces against all edges tested with all faces, and rings that can be counted."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

from grabnet.body.hand import HandModel
from grabnet.geometry.intersections import MovingMesh, find_crossings
from grabnet.geometry.kernels import queries as kernels
from grabnet.geometry.kernels.launch import launch


def moving(solid: trimesh.Trimesh) -> MovingMesh:
    return MovingMesh(solid.vertices, solid.faces)


def all_crossings(mesh: MovingMesh, other: MovingMesh) -> set[tuple[int, int]]:
    """(edge of `mesh`, face of `other`) by solving for the point on every edge's line, in double precision."""
    start, end = (mesh.vertices[mesh.edges[:, k]].astype(float) for k in (0, 1))
    a, b, c = np.moveaxis(other.vertices[other.faces].astype(float), 1, 0)
    found = set()
    for face in range(len(other.faces)):
        matrix = np.stack([b[face] - a[face], c[face] - a[face]], 1)
        system = np.concatenate([np.broadcast_to(matrix, (len(start), 3, 2)), (start - end)[..., None]], -1)
        regular = np.abs(np.linalg.det(system)) > 1e-25
        u, v, t = np.linalg.solve(system[regular], (start[regular] - a[face])[..., None])[..., 0].T
        inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)
        found |= {(int(edge), face) for edge in regular.nonzero()[0][inside]}
    return found


@pytest.mark.parametrize("seed", range(3))
def test_crossings_are_all_there_are(seed):
    hand = HandModel.open()
    rng = np.random.default_rng(seed)
    body = MovingMesh(hand.v_template.numpy(), hand.faces.numpy())
    solid = trimesh.creation.icosphere(2, 0.03)
    solid.vertices += rng.normal(0, 0.002, solid.vertices.shape)
    solid.apply_translation(hand.v_template[rng.integers(778)].numpy())
    thing = moving(solid)
    crossings = find_crossings(body, thing)
    pairs = list(zip(crossings.edge.tolist(), crossings.face.tolist(), strict=True))
    ours = {kind: {p for p, k in zip(pairs, crossings.of_object, strict=True) if k == kind} for kind in (False, True)}
    assert len(pairs) == len(set(zip(pairs, crossings.of_object.tolist(), strict=True))) > 50
    assert ours[False] == all_crossings(body, thing)
    assert ours[True] == all_crossings(thing, body)


def test_points_lie_on_both_surfaces_and_enter_against_the_normal():
    body, thing = moving(trimesh.creation.icosphere(3, 0.03)), moving(trimesh.creation.box((0.1, 0.1, 0.02)))
    crossings = find_crossings(body, thing)
    for of_object, own, other in ((False, body, thing), (True, thing, body)):
        chosen = crossings.of_object == of_object
        start, end = (own.vertices[own.edges[crossings.edge[chosen], k]] for k in (0, 1))
        point = start + crossings.along[chosen, None] * (end - start)
        a, b, c = np.moveaxis(other.vertices[other.faces[crossings.face[chosen]]], 1, 0)
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        assert np.abs(((point - a) * normal).sum(1)).max() < 1e-7
        np.testing.assert_array_equal(crossings.entering[chosen], ((end - start) * normal).sum(1) < 0)


@pytest.mark.parametrize(("height", "n_rings"), [(0.02, 2), (0.07, 0), (0.0, 2)])
def test_rings_of_a_ball_in_a_slab_are_counted(height, n_rings):
    """Also with faces so large that both rings pass the same ones."""
    ball = trimesh.creation.icosphere(3, 0.03)
    ball.apply_translation([0.003, 0.002, height])
    for slab in (trimesh.creation.box((0.2, 0.2, 0.01)), trimesh.creation.box((0.2, 0.2, 0.01)).subdivide()):
        assert find_crossings(moving(ball), moving(slab)).n_rings == n_rings


def test_rings_through_one_large_face_are_two():
    balls = [trimesh.creation.icosphere(3, 0.01).apply_translation([x, -0.04, 0.004]) for x in (-0.03, 0.0)]
    sheet = trimesh.Trimesh([[-0.2, -0.2, 0], [0.2, -0.2, 0], [0, 0.2, 0]], [[0, 1, 2]])
    crossings = find_crossings(moving(trimesh.util.concatenate(balls)), moving(sheet))
    assert crossings.n_rings == 2
    faces = crossings.body_faces >= len(balls[0].faces)
    assert len(set(crossings.body_face_ring[faces]) & set(crossings.body_face_ring[~faces])) == 0


def test_surfaces_that_do_not_meet_have_no_crossings():
    a, b = trimesh.creation.icosphere(2, 0.03), trimesh.creation.icosphere(2, 0.03).apply_translation([0.07, 0, 0])
    assert find_crossings(moving(a), moving(b)).n_rings == 0
    inside = trimesh.creation.icosphere(2, 0.01)
    assert find_crossings(moving(inside), moving(a)).n_rings == 0


def test_moving_a_mesh_moves_its_crossings():
    ball, slab = trimesh.creation.icosphere(3, 0.03), moving(trimesh.creation.box((0.2, 0.2, 0.01)))
    body = moving(ball)
    body.move(ball.vertices + np.array([0, 0, 0.5]))
    assert find_crossings(body, slab).n_rings == 0
    body.move(ball.vertices + np.array([0.003, 0.002, 0.02]))
    there = find_crossings(body, slab)
    anew = find_crossings(moving(ball.copy().apply_translation([0.003, 0.002, 0.02])), slab)
    np.testing.assert_array_equal(there.edge, anew.edge)
    assert there.n_rings == anew.n_rings == 2


def test_edges_are_those_of_the_faces():
    mesh = moving(trimesh.creation.icosphere(1))
    assert len(mesh.edges) == len(mesh.faces) * 3 // 2
    for face, edges in zip(mesh.faces, mesh.face_edges, strict=True):
        for k in range(3):
            assert sorted((face[k], face[(k + 1) % 3])) == mesh.edges[edges[k]].tolist()


def test_nearest_among_chosen_faces():
    solid = trimesh.creation.icosphere(2, 0.03)
    rng = np.random.default_rng(0)
    chosen = rng.random(len(solid.faces)) < 0.3
    points = rng.normal(0, 0.025, (500, 3)).astype(np.float32)
    distance, position = torch.full((500,), np.inf), torch.zeros(500, 3)
    face = torch.full((500,), -1, dtype=torch.int32)
    items = [torch.from_numpy(points), distance, position, face]
    mesh = moving(solid)
    launch(kernels.closest_of_faces, items, [mesh.mesh.id, 0.01, torch.from_numpy(chosen)])
    part = trimesh.Trimesh(solid.vertices, solid.faces[chosen], process=False)
    _, expected, _ = trimesh.proximity.closest_point_naive(part, points)
    near = expected < 0.01
    assert 50 < near.sum() < 450
    np.testing.assert_array_equal(face.numpy() >= 0, near)
    np.testing.assert_allclose(distance[near], expected[near], atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(position.numpy()[near] - points[near], axis=1), expected[near], atol=1e-7)
    assert chosen[face.numpy()[near]].all()
