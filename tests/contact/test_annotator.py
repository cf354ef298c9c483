"""Contact with known answers: fingers are capsules, objects plates, cups and pencils, all in metres."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.contact.annotator import ContactAnnotator, vertex_parts
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.openings import boundary_loops, close
from grabnet.geometry.queries import MeshQuery

RADIUS = 0.008
EPSILON = 0.0045
INDEX, MIDDLE = 41, 44


def fine(solid: trimesh.Trimesh, edge: float = 0.002) -> trimesh.Trimesh:
    solid = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(solid.vertices, solid.faces, edge))
    solid.merge_vertices()
    return solid


def finger(tip, direction=(0, 0, -1), length: float = 0.08) -> trimesh.Trimesh:
    """A capsule whose end is at `tip`, the rest behind it, turned a little about itself so that nothing is aligned."""
    capsule = fine(trimesh.creation.capsule(length, RADIUS, count=[32, 32]), 0.004)
    capsule.apply_transform(trimesh.transformations.rotation_matrix(0.3, [0, 0, 1]))
    capsule.apply_translation([0, 0, -capsule.vertices[:, 2].max()])
    capsule.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], direction))
    capsule.apply_translation(tip)
    return capsule


def axis_distance(points, tip, direction=(0, 0, -1), length: float = 0.08):
    """Distance of points to the capsule's surface, negative inside."""
    direction = np.asarray(direction, float)
    along = ((points - tip) @ direction).clip(-length - RADIUS, -RADIUS)
    return np.linalg.norm(points - tip - along[:, None] * direction, axis=1) - RADIUS


def plate(thickness: float = 0.01) -> trimesh.Trimesh:
    """Its upper face at z = 0."""
    solid = fine(trimesh.creation.box((0.06, 0.06, thickness)))
    solid.apply_translation([0.0003, 0.0004, -thickness / 2])
    return solid


def annotate(thing, *fingers, parts=(INDEX, MIDDLE), **options):
    body = trimesh.util.concatenate(list(fingers))
    labels = np.repeat(parts[: len(fingers)], [len(f.vertices) for f in fingers])
    annotator = ContactAnnotator(Mesh(thing.vertices, thing.faces), body.vertices, body.faces, labels, **options)
    return annotator(body.vertices), body


def assert_touched(labels, distance, expected_part=INDEX, also=True, margin=2e-4):
    """Exactly the vertices at negative `distance` are touched, but for those so near to zero that facets decide."""
    clear = np.abs(distance) > margin
    inside = (distance < 0) & also
    assert inside[clear].any()
    np.testing.assert_array_equal(labels[clear], np.where(inside, expected_part, 0)[clear])


@pytest.mark.parametrize("depth", [0.002, 0.005, 0.009])
def test_a_finger_through_a_plates_face_touches_what_lies_in_its_ring(depth):
    thing, tip = plate(thickness=0.01), np.array([0.001, -0.002, -depth])
    contact, body = annotate(thing, finger(tip))
    on_face = thing.vertices[:, 2] > -1e-6
    assert_touched(contact.object, axis_distance(thing.vertices, tip), also=on_face)
    touched = thing.vertices[contact.object > 0]
    reach = np.linalg.norm(body.vertices[:, None] - touched, axis=-1).min(1)
    np.testing.assert_array_equal(contact.body, np.where(reach <= EPSILON, INDEX, 0))


def test_of_a_thin_plates_two_faces_only_the_first_counts():
    thing, tip = plate(thickness=0.0015), np.array([0.001, -0.002, -0.02])
    contact, _ = annotate(thing, finger(tip))
    assert_touched(contact.object, axis_distance(thing.vertices, tip), also=thing.vertices[:, 2] > -1e-6)


def cup(wall: float) -> trimesh.Trimesh:
    """Open upwards, 35 mm in radius, its outer surface of vertices at that radius."""
    outer, inner = 0.035, 0.035 - wall
    profile = [[0, -0.03], [outer, -0.03], [outer, 0.04], [inner, 0.04], [inner, -0.03 + wall], [0, -0.03 + wall]]
    return fine(trimesh.creation.revolve(profile, sections=128), 0.0025)


@pytest.mark.parametrize("reach", [0.015, 0.09], ids=["into the cup", "out on the other side"])
@pytest.mark.parametrize("wall", [0.0012, 0.003])
def test_of_a_cups_walls_only_the_outermost_counts(wall, reach):
    thing, direction = cup(wall), np.array([-1.0, 0, 0])
    tip = np.array([0.035 - reach, 0.001, 0.0008])
    contact, _ = annotate(thing, finger(tip, direction, 0.15))
    radius = np.linalg.norm(thing.vertices[:, :2], axis=1)
    outer = (radius > 0.035 - 1e-4) & (thing.vertices[:, 0] > 0)
    assert_touched(contact.object, axis_distance(thing.vertices, tip, direction, 0.15), also=outer)


def test_the_inner_wall_does_not_count_for_the_next_part_either():
    """The outer wall cuts one phalanx, the inner wall the next."""
    thing, direction = cup(0.003), np.array([-1.0, 0, 0])
    tip = np.array([0.02, 0.001, 0.0008])
    body = finger(tip, direction)
    labels = np.where(body.vertices[:, 0] > 0.0335, INDEX, INDEX + 1)
    contact = ContactAnnotator(Mesh(thing.vertices, thing.faces), body.vertices, body.faces, labels)(body.vertices)
    radius = np.linalg.norm(thing.vertices[:, :2], axis=1)
    touched = contact.object > 0
    assert touched.any() and (radius[touched] > 0.035 - 1e-4).all()


def test_a_pencil_through_a_finger_is_touched_all_along():
    """Two rings of one part; what the larger encloses reaches to the other."""
    pencil = fine(trimesh.creation.cylinder(0.003, 0.1, sections=24))
    pencil.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    tip = np.array([0.0004, 0.0002, -0.03])
    contact, _ = annotate(pencil, finger(tip))
    assert_touched(contact.object, axis_distance(pencil.vertices, tip))


@pytest.mark.parametrize(("gap", "touches"), [(0.004, True), (0.0044, True), (0.0046, False), (0.005, False)])
def test_a_finger_that_hovers_touches_within_4_5_mm(gap, touches):
    thing, tip = plate(), np.array([0.001, 0.001, gap])
    contact, body = annotate(thing, finger(tip))
    assert (contact.object > 0).any() == touches and (contact.body > 0).any() == touches
    if touches:
        assert_touched(contact.object, axis_distance(thing.vertices, tip) - EPSILON, margin=5e-5)
        np.testing.assert_array_equal(contact.body > 0, body.vertices[:, 2] <= EPSILON)


def test_the_distance_can_be_chosen():
    thing, tip = plate(), np.array([0.001, 0.001, 0.009])
    contact, _ = annotate(thing, finger(tip), distance=0.01)
    assert_touched(contact.object, axis_distance(thing.vertices, tip) - 0.01, margin=5e-5)


def test_two_parts_at_once_one_in_the_object_and_one_above_it():
    thing = plate()
    deep, above = np.array([-0.014, 0, -0.004]), np.array([0.014, 0, 0.003])
    contact, body = annotate(thing, finger(deep), finger(above))
    left = thing.vertices[:, 0] < 0
    face = thing.vertices[:, 2] > -1e-6
    assert_touched(np.where(left, contact.object, 0), axis_distance(thing.vertices, deep), also=face)
    assert_touched(np.where(left, 0, contact.object), axis_distance(thing.vertices, above) - EPSILON, MIDDLE)
    assert set(np.unique(contact.body)) == {0, INDEX, MIDDLE}
    assert (contact.body[body.vertices[:, 0] > 0] != INDEX).all()


def test_two_parts_through_one_face_touch_each_its_own():
    thing, tips = plate(), [np.array([x, 0.001, -0.004]) for x in (-0.014, 0.014)]
    contact, _ = annotate(thing, *map(finger, tips))
    face, left = thing.vertices[:, 2] > -1e-6, thing.vertices[:, 0] < 0
    for tip, part, half in ((tips[0], INDEX, left), (tips[1], MIDDLE, ~left)):
        assert_touched(np.where(half, contact.object, 0), axis_distance(thing.vertices, tip), part, also=face)


def test_a_part_turned_inside_out_does_not_make_the_rest_touch():
    thing, tip = plate(), np.array([0.001, -0.002, -0.005])
    folded = fine(trimesh.creation.icosphere(3, 0.004), 0.002)
    folded.apply_translation([0.0215, 0.0127, 0.0013])
    folded.invert()
    contact, _ = annotate(thing, finger(tip), folded)
    on_face = thing.vertices[:, 2] > -1e-6
    assert_touched(contact.object, axis_distance(thing.vertices, tip), also=on_face)


def test_open_surfaces():
    """A sheet without thickness, and a finger open at its far end."""
    thing = plate()
    thing.update_faces(thing.triangles_center[:, 2] > -1e-6)
    thing.remove_unreferenced_vertices()
    tip = np.array([0.001, -0.002, -0.006])
    body = finger(tip)
    body.update_faces(body.triangles_center[:, 2] < 0.06)
    body.remove_unreferenced_vertices()
    assert not thing.is_watertight and not body.is_watertight
    contact, _ = annotate(thing, body)
    assert_touched(contact.object, axis_distance(thing.vertices, tip))


def pencil(start: float, end: float) -> trimesh.Trimesh:
    """Along z, thinner than a finger."""
    solid = fine(trimesh.creation.cylinder(0.003, end - start, sections=16), 0.004)
    solid.apply_transform(trimesh.transformations.rotation_matrix(0.1, [0, 0, 1]))
    solid.apply_translation([0.0007, 0.0011, (start + end) / 2])
    return solid


def open_finger(tip) -> trimesh.Trimesh:
    """A finger cut off 6 cm behind its tip, more or less straight."""
    body = finger(tip)
    body.update_faces(body.triangles_center[:, 2] < tip[2] + 0.06)
    body.remove_unreferenced_vertices()
    return body


def test_what_leaves_a_finger_through_its_opening_touches_only_inside():
    """A pencil goes in at the tip, along the finger, and out where it is open."""
    tip = np.array([0.0, 0.0, -0.01])
    body, thing = open_finger(tip), pencil(-0.03, 0.12)
    contact, _ = annotate(thing, body)
    rim = body.vertices[np.unique(body.edges[trimesh.grouping.group_rows(body.edges_sorted, require_count=1)])][:, 2]
    ragged = (thing.vertices[:, 2] > rim.min() - 1e-3) & (thing.vertices[:, 2] < rim.max() + 1e-3)
    distance = np.where(thing.vertices[:, 2] > rim.mean(), 1.0, axis_distance(thing.vertices, tip))
    distance[ragged] = 0  # where exactly the lid is does not matter
    assert_touched(contact.object, distance)
    touched = contact.object > 0
    assert (contact.face[touched] < len(body.faces)).all()


def test_what_is_put_into_an_opening_touches_nothing_it_does_not_come_near():
    """The same pencil reaches in from the other end only, 5 mm away from the wall all around."""
    body, thing = open_finger(np.array([0.0, 0.0, -0.01])), pencil(0.01, 0.12)
    contact, _ = annotate(thing, body, distance=0.002)
    assert not contact.object.any() and not contact.body.any()
    near, _ = annotate(thing, body, distance=0.0055)
    assert (near.object > 0).any()


def test_a_hand_by_itself_is_open_at_the_wrist_only():
    """A rod through the palm and out at the wrist: touched from the palm's skin to the wrist and no further."""
    hand = HandModel.open()
    anatomy, vertices, faces = Anatomy.of(hand), hand.v_template.numpy(), hand.faces.numpy()
    rim, palm = vertices[boundary_loops(faces)[0]].mean(0), vertices[anatomy.pads["palm_mcp"]].mean(0)
    along = (palm - rim) / np.linalg.norm(palm - rim)
    rod = fine(trimesh.creation.cylinder(0.002, 0.3, sections=8), 0.004)
    rod.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], along))
    rod.apply_translation(rim)
    touched = ContactAnnotator(Mesh(rod.vertices, rod.faces), vertices, faces, np.full(778, 22))(vertices).object > 0
    query = MeshQuery(Mesh(*close(vertices, faces)))
    inside = (query.signed_distance(torch.tensor(rod.vertices).float()) < 0).numpy()
    place = (rod.vertices - rim) @ along
    assert inside[place > 0].any() and not inside[(place > 0.13) | (place < -0.02)].any()
    np.testing.assert_array_equal(touched, inside)


def test_a_ring_that_runs_out_at_the_rim_still_counts():
    """Half of the finger is in the sheet, half beyond its edge."""
    thing = plate()
    thing.update_faces(thing.triangles_center[:, 2] > -1e-6)
    thing.remove_unreferenced_vertices()
    tip = np.array([thing.vertices[:, 0].max() - 0.0005, 0.001, -0.015])
    contact, _ = annotate(thing, finger(tip))
    assert_touched(contact.object, axis_distance(thing.vertices, tip))


def test_an_object_between_the_fingers_without_contact():
    ball = trimesh.creation.icosphere(3, 0.006)
    contact, body = annotate(ball, finger([-0.025, 0, -0.04]), finger([0.025, 0, -0.04]))
    low, high = body.bounds
    assert (ball.vertices > low).all() and (ball.vertices < high).all()
    assert not contact.object.any() and not contact.body.any() and (contact.face == -1).all()


def test_a_body_far_away_touches_nothing():
    contact, _ = annotate(plate(), finger([0, 0, 1.0]))
    assert not contact.object.any() and not contact.body.any()


def test_an_object_swallowed_whole_touches_nothing_within_reach_of_no_surface():
    """No surfaces cut and none is near: a pea of 1 mm in the middle of a finger of 8."""
    pea = trimesh.creation.icosphere(2, 0.001)
    contact, _ = annotate(pea, finger([0, 0, -0.04]))
    assert not contact.object.any()


@pytest.mark.parametrize("depth", [0.003, -0.002])
def test_the_dense_correspondence_is_the_nearest_point_of_the_body(depth):
    thing, tip = plate(), np.array([0.001, -0.002, -depth])
    contact, body = annotate(thing, finger(tip))
    touched = contact.object > 0
    np.testing.assert_array_equal(touched, contact.face >= 0)
    np.testing.assert_allclose(contact.barycentric[touched].sum(1), 1, atol=1e-5)
    points = (body.triangles[contact.face[touched]] * contact.barycentric[touched][..., None]).sum(1)
    distance = np.linalg.norm(points - thing.vertices[touched], axis=1)
    in_mm = body.copy().apply_scale(1000)  # trimesh is off by tens of micrometres for small triangles in metres
    _, expected, _ = trimesh.proximity.closest_point_naive(in_mm, 1000 * thing.vertices[touched])
    np.testing.assert_allclose(1000 * distance, expected, atol=1e-3)
    assert np.isnan(contact.barycentric[~touched]).all()


def test_one_annotator_serves_a_moving_body():
    thing = plate()
    body = finger([0.0, 0.0, 0.03])
    annotator = ContactAnnotator(
        Mesh(thing.vertices, thing.faces), body.vertices, body.faces, np.full(len(body.vertices), 41)
    )
    assert not annotator(body.vertices).object.any()
    for x in (-0.01, 0.0, 0.012):
        tip = np.array([x, 0.001, -0.004])
        contact = annotator(finger(tip).vertices)
        assert_touched(contact.object, axis_distance(thing.vertices, tip), also=thing.vertices[:, 2] > -1e-6)


def test_parts_are_joints_counted_from_one():
    weights = np.zeros((3, 55))
    weights[[0, 1, 2], [0, 21, 54]] = 0.6
    weights[:, 3] = 0.4
    assert vertex_parts(weights).tolist() == [1, 22, 55]
