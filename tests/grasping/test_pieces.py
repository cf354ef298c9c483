"""Whether hands are cut apart, against a mesh boolean."""

from __future__ import annotations

import manifold3d
import numpy as np
import pytest
import torch
import trimesh

from grabnet.geometry.mesh import Mesh
from grabnet.geometry.openings import close
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.rotations import random_rotations
from grabnet.grasping.interior import Interior
from grabnet.grasping.lines import Lines
from grabnet.grasping.measures import pieces
from grabnet.grasping.pieces import SLIVER

from .hands import bent, contacts_with

SOLIDS = {
    "wall": lambda: trimesh.creation.box((0.12, 0.12, 0.003)),
    "box": lambda: trimesh.creation.box((0.06, 0.06, 0.06)),
    "wire": lambda: trimesh.creation.cylinder(0.0015, 0.2, sections=12),
    "ball": lambda: trimesh.creation.icosphere(3, 0.035),
    "ring": lambda: trimesh.creation.torus(0.011, 0.004),
    "tube": lambda: trimesh.creation.annulus(0.030, 0.033, 0.1, sections=32),
}


def of(mesh: Mesh, vertices: torch.Tensor, faces: torch.Tensor, hand) -> tuple[torch.Tensor, Lines]:
    query, contacts = MeshQuery(mesh), contacts_with(mesh, vertices, hand.anatomy.finger)
    lines = Lines.of(Interior.of(hand), query, vertices, contacts.distances)
    counted = pieces(mesh, query, vertices, faces, contacts.distances, lines)
    alone = pieces(mesh, query, vertices, faces, contacts.distances, None)
    assert (counted <= alone).all()  # lines only ever join
    return counted, lines


@pytest.mark.parametrize("name", SOLIDS)
def test_as_many_pieces_as_a_mesh_boolean_leaves(model, hand, name):

    def solid(vertices: np.ndarray, faces: np.ndarray):
        made = manifold3d.Manifold(
            manifold3d.Mesh(np.array(vertices, np.float32), np.array(faces, np.uint32, order="C"))
        )
        assert made.status() == manifold3d.Error.NoError
        return made

    made = SOLIDS[name]()
    mesh = Mesh(made.vertices, made.faces)
    generator = torch.Generator().manual_seed(0)
    n = 16
    posed = hand.posed(bent(hand, *torch.linspace(0, 0.45, n).tolist())).vertices
    turned = (posed - posed.mean(1, keepdim=True)) @ random_rotations(n, generator)
    at = turned[torch.arange(n), torch.randint(0, turned.shape[1], (n,), generator=generator)]
    near = torch.from_numpy(mesh.sample_surface(n, 1)[0]) + 0.001 * torch.randn(n, 3, generator=generator)
    vertices = turned + (near - at).unsqueeze(1)
    found, _ = of(mesh, vertices, model.faces, hand)
    closed, faces = close(vertices.numpy(), model.faces.numpy())
    other = solid(mesh.vertices, mesh.faces)
    left = [(solid(hand_vertices, faces) - other).decompose() for hand_vertices in closed]
    query = MeshQuery(mesh)

    def rises(part) -> bool:
        return bool(
            query.signed_distance(torch.from_numpy(part.to_mesh().vert_properties[:, :3].copy())).max() > SLIVER
        )

    # Hollows are parts of negative volume.
    expected = [sum(part.volume() > 0 and rises(part) for part in parts) for parts in left]
    assert found.tolist() == expected
    assert min(expected) == 1 and (max(expected) > 1 or name in ("wire", "ring"))


def test_a_thin_wall_through_a_finger_and_one_pressed_on(model, hand):
    vertices = hand.posed(bent(hand, 0.0)).vertices
    tip = vertices[0, hand.anatomy.tips[2]]
    along = tip - hand.joints[5]
    along = along / along.norm()

    def wall(offset: float, thickness: float) -> tuple[int, bool]:
        box = trimesh.creation.box((0.05, 0.05, thickness))
        box.apply_transform(trimesh.geometry.align_vectors((0, 0, 1), along.numpy()))
        mesh = Mesh(box.vertices + (tip + offset * along).numpy(), box.faces)
        counted, lines = of(mesh, vertices, model.faces, hand)
        return int(counted[0]), bool(lines.bone_crosses[0])

    assert wall(-0.012, 0.003) == (2, True)
    assert wall(-0.004, 0.0005) == (2, False)  # only the fingertip's end, beyond the last point of the bone
    assert wall(0.0, 0.003) == (1, False)  # pressed 1.5 mm deep
    assert wall(0.01, 0.003) == (1, False)  # apart


def test_a_ring_worn_too_tight_cuts_nothing_off(model, hand):
    """The skin falls into two parts, which the finger within the ring holds together."""
    vertices = hand.posed(bent(hand, 0.0)).vertices
    posed = Interior.of(hand).points(vertices)
    middle = (hand.sphere_bone == 5).nonzero().squeeze(1)
    a, b = posed[0, middle[0]], posed[0, middle[-1]]
    radius = float(hand.radii[middle].mean())
    ring = trimesh.creation.torus(radius, 0.003)
    ring.apply_transform(trimesh.geometry.align_vectors((0, 0, 1), ((b - a) / (b - a).norm()).numpy()))
    mesh = Mesh(ring.vertices + posed[0, middle[1]].numpy(), ring.faces)
    counted, lines = of(mesh, vertices, model.faces, hand)
    assert int(counted[0]) == 1 and not lines.bone_crosses[0]
    inside = contacts_with(mesh, vertices, hand.anatomy.finger).distances[0] < 0
    assert inside.sum() > 5


def test_a_hand_swallowed_whole_is_in_no_piece_but_its_bones_are_hit(model, hand):
    box = trimesh.creation.box((1, 1, 1))
    counted, lines = of(Mesh(box.vertices, box.faces), hand.posed(bent(hand, 0.0)).vertices, model.faces, hand)
    assert int(counted[0]) == 0 and lines.bone_crosses[0]
    assert (lines.through > 0).all()
