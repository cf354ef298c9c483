"""The two ways to annotate contact, against brute force: all distances between vertices, all bones."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import cKDTree

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.body.skeleton import JOINTS, PARENTS, RIGHT_HAND_PARTS
from grabnet.body.whole import BodyModel, BodyParameters
from grabnet.cli.entry import compose
from grabnet.contact.annotator import ContactAnnotator
from grabnet.contact.bones import Bones
from grabnet.contact.hands import HandAnnotator
from grabnet.contact.rules import ContactRules
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.rotations import axis_angle_to_matrix
from tests.contact.test_annotator import EPSILON, INDEX, MIDDLE, finger, plate


def nearest_bone(bones, places):
    """Labels of the bones (start, end, part) nearest to places, and by how much nearer than any other part's."""
    labels, margins = [], []
    for place in places:
        by_part = {}
        for start, end, part in bones:
            share = np.clip((place - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
            distance = np.linalg.norm(start + share * (end - start) - place)
            by_part[part] = min(distance, by_part.get(part, np.inf))
        nearest = sorted((distance, part) for part, distance in by_part.items())
        labels.append(nearest[0][1])
        margins.append(nearest[1][0] - nearest[0][0])
    return np.array(labels), np.array(margins)


def bones_between(parents, joints, tips, parts):
    """Bones from each joint to those that hang on it, and of the last ones to tips, by joint."""
    bones = [(joints[p], joints[j], parts[p]) for j, p in enumerate(parents) if p >= 0]
    return bones + [(joints[j], tip, parts[j]) for j, tip in tips.items()]


def farthest_of_its_own(weights, rest, joints, joint):
    """Number of the rest vertex farthest from a joint, of those that it moves most."""
    own = (np.asarray(weights).argmax(1) == joint).nonzero()[0]
    return own[np.linalg.norm(np.asarray(rest)[own] - np.asarray(joints)[joint], axis=1).argmax()]


def test_bones_of_a_moving_body_are_where_its_joints_are():
    """A reader who has the pose, and so the joints, finds the same bones."""
    body = BodyModel.open()
    generator = torch.Generator().manual_seed(0)
    poses = 0.5 * torch.randn(3, 55, 3, generator=generator)
    rest = body.shaped(torch.randn(10, generator=generator))
    posed = body(BodyParameters.from_rotations(axis_angle_to_matrix(poses), torch.zeros(3, 3)), rest)
    bones = Bones.of(body, rest.numpy(), range(1, 56))
    ends = [j for j in range(55) if j not in PARENTS]
    assert {JOINTS[j] for j in ends} >= {"left_foot", "jaw", "right_thumb3", "left_pinky3"}
    last = {j: farthest_of_its_own(body.weights, rest, body.rest_joints(rest), j) for j in ends}
    rng = np.random.default_rng(0)
    for vertices, joints in zip(posed.vertices.double().numpy(), posed.joints.double().numpy(), strict=True):
        tips = {j: vertices[vertex] for j, vertex in last.items()}
        places = vertices[rng.choice(len(vertices), 300)] + rng.normal(0, 0.02, (300, 3))
        expected, margin = nearest_bone(bones_between(PARENTS, joints, tips, range(1, 56)), places)
        clear = margin > 1e-5
        assert clear.mean() > 0.8  # about a joint the bones that meet there are equally near
        np.testing.assert_array_equal(bones.nearest_parts(vertices, places)[clear], expected[clear])


@pytest.fixture(scope="module")
def hand():
    return HandModel.open()


def beside_hand(hand: HandModel, radius: float, gap: float) -> Mesh:
    """A ball under the fingers of the flat hand, `gap` metres away from the nearest vertex."""
    ball = trimesh.creation.icosphere(4, radius)
    vertices = hand.v_template.double().numpy()
    middle = vertices[Anatomy.of(hand).finger.numpy() == 2].mean(0)
    down = np.array([0, -1.0, 0])
    depths, tree = np.linspace(0, 0.1, 2001), cKDTree(vertices)
    reach = [tree.query(middle + (radius + d) * down)[0] - radius for d in depths]
    depth = depths[(np.array(reach) > gap).argmax()]
    ball.apply_translation(middle + (radius + depth) * down)
    return Mesh(ball.vertices, ball.faces)


@pytest.mark.parametrize("gap", [0.0005, 0.002, 0.004])
def test_to_vertices_is_what_a_tree_of_vertices_finds(hand, gap):
    thing, vertices = beside_hand(hand, 0.02, gap), hand.v_template.numpy()
    parts = np.array(RIGHT_HAND_PARTS, np.uint8)[Anatomy.of(hand).bone.numpy()]
    annotator = ContactAnnotator(thing, vertices, hand.faces.numpy(), parts, EPSILON, "vertices")
    contact = annotator(vertices)
    to_hand, nearest = cKDTree(vertices.astype(float)).query(thing.vertices.astype(float))
    to_object, _ = cKDTree(thing.vertices.astype(float)).query(vertices.astype(float))
    assert (to_hand <= EPSILON).any()
    np.testing.assert_array_equal(contact.object > 0, to_hand <= EPSILON)
    np.testing.assert_array_equal(contact.body, np.where(to_object <= EPSILON, parts, 0))
    np.testing.assert_array_equal(contact.face >= 0, to_hand <= EPSILON)
    fingers = {(part - 41) // 3 for part in contact.object[contact.object > 0].astype(int)}
    assert fingers == {(part - 41) // 3 for part in parts[nearest[to_hand <= EPSILON]].astype(int)}


def test_to_the_surface_counts_what_lies_between_vertices(hand):
    thing, vertices = beside_hand(hand, 0.02, 0.004), hand.v_template.numpy()
    parts = np.full(len(vertices), INDEX)
    found = {
        to: ContactAnnotator(thing, vertices, hand.faces.numpy(), parts, EPSILON, to)(vertices).object > 0
        for to in ("vertices", "surface")
    }
    assert (found["surface"] | ~found["vertices"]).all() and found["surface"].sum() > 1.2 * found["vertices"].sum()


def test_parts_that_cut_do_not_count_as_near_to_vertices_either():
    """One finger is in the plate, the other hovers: only the hovering one's vertices reach over ε."""
    thing = plate()
    deep, above = finger(np.array([-0.014, 0, -0.004])), finger(np.array([0.014, 0, 0.003]))
    body = trimesh.util.concatenate([deep, above])
    parts = np.repeat([INDEX, MIDDLE], [len(deep.vertices), len(above.vertices)])
    mesh = Mesh(thing.vertices, thing.faces)
    to_vertices = ContactAnnotator(mesh, body.vertices, body.faces, parts, EPSILON, "vertices")(body.vertices)
    to_surface = ContactAnnotator(mesh, body.vertices, body.faces, parts, EPSILON)(body.vertices)
    left = thing.vertices[:, 0] < 0
    np.testing.assert_array_equal(to_vertices.object[left], to_surface.object[left])  # what the ring encloses
    reach = cKDTree(above.vertices).query(thing.vertices[~left])[0]
    np.testing.assert_array_equal(to_vertices.object[~left], np.where(reach <= EPSILON, MIDDLE, 0))
    touched = thing.vertices[to_vertices.object == INDEX]
    near = cKDTree(touched).query(deep.vertices)[0] <= EPSILON
    np.testing.assert_array_equal(to_vertices.body[: len(near)], np.where(near, INDEX, 0))


def test_the_papers_labels_are_those_of_the_nearest_bone(hand):
    """A flat hand's joints are those of its template."""
    thing, vertices = beside_hand(hand, 0.06, 0.002), hand.v_template.numpy()
    anatomy, joints = Anatomy.of(hand), hand.rest_joints(hand.v_template).double().numpy()
    parts = np.array(RIGHT_HAND_PARTS, np.uint8)[anatomy.bone.numpy()]
    bones, rules = Bones.of(hand, vertices, RIGHT_HAND_PARTS), ContactRules("vertices", "bone")
    annotate = HandAnnotator(thing, vertices, hand.faces.numpy(), parts, 0.01, rules, bones)
    labels = annotate(vertices[None]).object[0]
    tips = {j: vertices[farthest_of_its_own(hand.weights, vertices, joints, j)] for j in (3, 6, 9, 12, 15)}
    touched = labels > 0
    expected, margin = nearest_bone(
        bones_between(hand.parents, joints, tips, RIGHT_HAND_PARTS), thing.vertices[touched].astype(float)
    )
    clear = margin > 1e-5
    assert clear.sum() > 20 and len(np.unique(expected[clear])) > 3
    np.testing.assert_array_equal(labels[touched][clear], expected[clear])


@pytest.mark.parametrize("command", ["preprocess/preprocess", "evaluate", "sample/sample"])
def test_the_paper_is_one_choice_in_every_command(command):
    needed = ["mesh=cup.obj"] if command == "sample/sample" else []
    chosen = compose(command, [*needed, "contact=paper"]).contact
    assert (chosen.measured_to, chosen.part_by) == ("vertices", "bone")
    default = compose(command, needed).contact
    assert (default.measured_to, default.part_by) == ("surface", "skinning")


@pytest.mark.parametrize("values", [{"measured_to": "skin"}, {"part_by": "joint"}])
def test_other_ways_are_refused(values):
    with pytest.raises(UserError, match=r"^contact\.\w+ is '\w+'; it can be \w+, \w+\.$"):
        ContactRules(**values)
