from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

from grabnet.body.anatomy import FINGERS
from grabnet.contact.contacts import Contacts
from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.intersections import MovingMesh
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.rotations import random_rotations
from grabnet.geometry.sdf_grid import SDFGrid
from grabnet.grasping.contact_area import ContactArea
from grabnet.grasping.interior import Interior
from grabnet.grasping.joints import beyond_limits
from grabnet.grasping.lines import Lines
from grabnet.grasping.measures import DEFINITIONS, measure_grasps
from grabnet.grasping.opposition import opposition
from grabnet.grasping.screening import screen

from .hands import bent, contacts_with, mirrored, plate


def measured(hand, faces, mesh, vertices, angles):
    contacts = contacts_with(mesh, vertices, hand.anatomy.finger)
    return measure_grasps(hand, mesh, vertices, faces, hand.anatomy.hand_pose(angles), contacts)


def test_depth_through_a_wall_is_that_of_the_formula(model, hand):
    """A plate across the middle finger: of each line, what lies beyond the plate's near side."""
    vertices = hand.posed(bent(hand, 0.0)).vertices
    interior = Interior.of(hand)
    points = interior.points(vertices)[0]
    along = torch.nn.functional.normalize(vertices[0, hand.anatomy.tips[2]] - hand.joints[5], dim=0)
    middle = points[(hand.sphere_bone == 5).nonzero()[1, 0]] + 0.002 * along
    mesh = plate(0.001, middle, along)
    contacts = contacts_with(mesh, vertices, hand.anatomy.finger)
    lines = Lines.of(interior, MeshQuery(mesh), vertices, contacts.distances)
    foot = points[hand.foot]
    start, end = (foot - middle) @ along, (vertices[0] - middle) @ along
    length = (vertices[0] - foot).norm(dim=1)
    near_side = 0.0005 * start.sign()
    share = ((near_side - start) / (end - start)).clamp(0, 1)
    expected = torch.where((end - near_side) * start.sign() > 0, 0, (1 - share) * length)  # 0: ends before the plate
    expected = torch.where(start.abs() < 0.0005, length, expected)
    torch.testing.assert_close(lines.through[0], expected, atol=2e-5, rtol=0)
    assert expected.max() > 0.003 and contacts.max_penetration < 0.0006
    assert (lines.through[0] + 1e-6 >= -contacts.distances[0]).all()


def test_pressing_on_a_plate_is_no_piercing(model, hand):
    pose = bent(hand, 0.0)
    vertices = hand.posed(pose).vertices
    pads = torch.cat([hand.anatomy.pads[f"{finger}3"] for finger in FINGERS[1:]])
    palmar = torch.nn.functional.normalize(hand.normals[pads].mean(0), dim=0)
    lowest = (vertices[0] @ palmar).max()
    mesh = plate(0.003, palmar * (lowest + 0.0015 - 0.0008), palmar)
    found = measured(hand, model.faces, mesh, vertices, pose.angles)
    assert not found.pierced[0]
    assert 0.7 < found.through_mm[0] < 3
    assert found.skin_contact_cm2[0] > 1
    assert found.opposition[0] <= 0  # all from one side
    assert found.joint_excess_deg[0] == found.crossing_mm[0] == 0


def test_nothing_near_is_zero_everywhere(model, hand):
    pose = bent(hand, 0.2, 0.4)
    far = Mesh(*ball(0.03, (1.0, 0, 0)))
    found = measured(hand, model.faces, far, hand.posed(pose).vertices, pose.angles)
    for record in found.report():
        assert record.keys() == DEFINITIONS.keys()
        assert not any(record.values())


def ball(radius: float, centre: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    made = trimesh.creation.icosphere(4, radius)
    return made.vertices + np.array(centre), made.faces


@pytest.fixture(scope="module")
def held(hand):
    """Hands about a thick tube, open at both ends, some through its wall."""
    n = 6
    generator = torch.Generator().manual_seed(1)
    pose = bent(hand, *torch.linspace(0.1, 0.6, n).tolist())
    made = trimesh.creation.annulus(0.028, 0.031, 0.1, sections=40)
    mesh = Mesh(made.vertices, made.faces).subdivided()
    grip = hand.posed(pose).vertices[:, hand.anatomy.pads["middle2"]].mean(1, keepdim=True)
    vertices = (hand.posed(pose).vertices - grip) @ random_rotations(n, generator)
    vertices = vertices + torch.from_numpy(mesh.sample_surface(n)[0]).unsqueeze(1)
    return mesh, vertices, pose


def test_a_mirrored_grasp_measures_the_same(model, hand, held):
    mesh, vertices, pose = held
    as_it_is = measured(hand, model.faces, mesh, vertices, pose.angles)
    in_mirror = vertices * torch.tensor([-1.0, 1, 1])
    other = measured(hand, model.faces.flip(1), mirrored(mesh), in_mirror, pose.angles)
    assert as_it_is.pierced.any() and as_it_is.skin_contact_cm2.any()
    for one, two in zip(as_it_is.report(), other.report(), strict=True):
        # At a sharp rim either of two faces may be the nearest.
        assert one.pop("skin_contact_cm2") == pytest.approx(two.pop("skin_contact_cm2"), rel=0.05)
        assert one.pop("opposition") == pytest.approx(two.pop("opposition"), abs=0.05)
        assert one == pytest.approx(two, abs=2e-3)


def test_each_grasp_is_measured_by_itself_and_inside_out_objects_as_others(model, hand, held):
    mesh, vertices, pose = held
    everything = measured(hand, model.faces, mesh, vertices, pose.angles)
    turned = measured(hand, model.faces, Mesh(mesh.vertices, mesh.faces[:, ::-1]), vertices, pose.angles)
    alone = measured(hand, model.faces, mesh, vertices[2:3].contiguous(), pose.angles[2:3])
    for one, two in ((everything, turned), (everything.select(slice(2, 3)), alone)):
        for a, b in zip(one.report(), two.report(), strict=True):
            assert a == pytest.approx(b, abs=2e-3)


def test_screening_finds_nearly_the_same(model, hand, held, tmp_path):
    mesh, vertices, pose = held
    exact = measured(hand, model.faces, mesh, vertices, pose.angles)
    atlas = SDFAtlas([SDFGrid.load_or_build(mesh, tmp_path)])
    interior = Interior.of(hand)
    found = screen(
        hand,
        interior,
        interior.posed(vertices),
        hand.anatomy.hand_pose(pose.angles),
        lambda points: atlas.with_gradient(points, torch.zeros(len(points), dtype=torch.int64)),
    )
    torch.testing.assert_close(found.crossing_mm, exact.crossing_mm)
    torch.testing.assert_close(found.joint_excess_deg, exact.joint_excess_deg)
    assert (found.through_mm <= exact.through_mm + 0.5).all()  # it looks at seven places of each line
    assert (found.bone_mm[exact.pierced] > 0).float().mean() >= 0.5
    assert (found.depth_mm >= 0).all() and torch.isfinite(found.bone_mm).all()


def test_opposition_of_known_normals():
    finger = torch.tensor([0, 1, 2, -1])
    x, y = torch.tensor([1.0, 0, 0]), torch.tensor([0.0, 1, 0])
    normals = torch.stack([torch.stack(n) for n in ((x, -x, y, y), (x, x, x, x), (x, -x, -x, -x), (x, y, y, -x))])
    touching = torch.tensor([[1, 1, 1, 1], [1, 1, 1, 0], [0, 1, 1, 1], [1, 0, 1, 1]], dtype=torch.bool)
    assert opposition(touching, normals, finger).tolist() == [1, -1, 0, 1]
    assert opposition(torch.zeros_like(touching), normals * torch.nan, finger).tolist() == [0, 0, 0, 0]


def test_contact_area_of_a_plate_over_a_plate():
    """5 cm² of "hand" 3 mm above a large plate; face by face, as the definition has it."""
    made = trimesh.creation.box((0.02, 0.025, 0.01)).subdivide().subdivide().subdivide()
    table = plate(0.01, torch.tensor([0.0, 0, -0.013]), torch.tensor([0.0, 0, 1])).subdivided().subdivided()
    found = 1e4 * ContactArea(table)(MovingMesh(made.vertices, made.faces))
    query = MeshQuery(Mesh(made.vertices, made.faces))
    top = (table.triangles[..., 2] > -0.0081).all(1)
    corners = torch.from_numpy(table.triangles[top].reshape(-1, 3))
    near = (query.closest(corners).distance.view(-1, 3) < 0.005).any(1).numpy()
    a, b, c = np.moveaxis(table.triangles[top][near].astype(float), 1, 0)
    expected = 1e4 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert found == pytest.approx(expected, rel=1e-6)
    assert 5 < expected < 25
    assert ContactArea(table)(MovingMesh(made.vertices + np.array([0, 0, 0.01]), made.faces)) == 0


def test_excess_is_that_of_the_angle_turned_too_far(hand):
    angles = torch.zeros(2, 21)
    limit = float(hand.anatomy.angle_limits[2, 1])
    angles[1, 2] = limit + 0.2
    beyond, off_axis = beyond_limits(hand.anatomy, hand.anatomy.hand_pose(angles))
    assert float(beyond[0].max()) == 0
    assert float(beyond[1, 2]) == pytest.approx(np.rad2deg(0.2), abs=1e-3)
    assert float(off_axis.max()) < 0.1


def test_a_closed_box_around_nothing_and_an_open_mesh_are_measured(model, hand):
    pose = bent(hand, 0.3)
    vertices = hand.posed(pose).vertices
    room = trimesh.creation.box((0.5, 0.5, 0.5))
    bowl = Mesh(*ball(0.04, tuple(vertices[0].mean(0).tolist())))
    bowl = Mesh(bowl.vertices, bowl.faces[bowl.triangles[..., 2].mean(1) < vertices[0].mean(0)[2].item()])
    for mesh in (Mesh(room.vertices, room.faces[:, ::-1]), bowl):
        found = measured(hand, model.faces, mesh, vertices, pose.angles)
        assert all(np.isfinite(list(record.values())).all() for record in found.report())
        assert found.pierced[0]


def test_a_contact_without_vertices_in_reach_has_no_normals(model, hand):
    """Distances may be infinite where nothing is near."""
    pose = bent(hand, 0.1)
    vertices = hand.posed(pose).vertices
    mesh = Mesh(*ball(0.02, (0.5, 0, 0)))
    contacts = Contacts(distances=torch.full(vertices.shape[:2], torch.inf), finger=hand.anatomy.finger)
    found = measure_grasps(hand, mesh, vertices, model.faces, hand.anatomy.hand_pose(pose.angles), contacts)
    assert not any(found.report()[0].values())
