"""What is measured of single grasps, against closed forms."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch
import trimesh

from grabnet.body.anatomy import FINGERS
from grabnet.body.hand import HandModel, HandParameters
from grabnet.evaluation.hands import HandLabels, Hands
from grabnet.evaluation.protocols.contact import PARTS, FingerContact, vertex_areas
from grabnet.evaluation.protocols.contact_maps import ContactMaps
from grabnet.evaluation.protocols.grasptta import GraspTTA
from grabnet.evaluation.protocols.ground_truth import ClosestHand
from grabnet.evaluation.protocols.halo import Halo
from grabnet.evaluation.protocols.penetration import Penetration
from grabnet.evaluation.protocols.posture import Posture, joint_limits
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.openings import boundary_loops
from grabnet.geometry.queries import MeshQuery
from tests.evaluation.shapes import ball, moved, scene

EPSILON = 0.0045


def posed(hand: HandModel, n: int = 1, **angles: float) -> Hands:
    """The open hand, flat but for some anatomical angles."""
    anatomy = HandLabels.of(hand).anatomy
    values = torch.zeros(n, 21)
    for name, value in angles.items():
        values[:, anatomy.angle_names.index(name)] = value
    pose = anatomy.hand_pose(values)
    parameters = HandParameters(torch.eye(3).expand(n, 3, 3), pose, torch.zeros(n, 3))
    return Hands(vertices=hand(parameters).vertices.numpy(), faces=hand.faces.numpy(), hand_pose=pose.numpy())


def test_two_balls():
    """Volume of a lens, depth along the line of centres, contact below and above the protocols' reach."""
    r, gap = 0.03, np.array([0.04, 0.055, 0.0645, 0.0655])
    found = moved(ball(r), *[(d, 0, 0) for d in gap])
    of = scene(ball(r), found)
    lens = np.where(gap < 2 * r, np.pi * (4 * r + gap) * (2 * r - gap) ** 2 / 12, 0)
    halo = Halo()(of)
    np.testing.assert_allclose(halo["volume"], 1e6 * lens, rtol=0.02)
    np.testing.assert_allclose(halo["depth"], 100 * np.maximum(2 * r - gap, 0), atol=0.01)
    np.testing.assert_array_equal(halo["contact"], gap < 2 * r)
    coarse = GraspTTA()(of)
    np.testing.assert_array_equal(coarse["contact"], gap < 2 * r + 0.005)
    np.testing.assert_allclose(coarse["volume"], 1e6 * lens, atol=1.0)  # eight voxels
    np.testing.assert_allclose(coarse["volume"] / 0.125, np.round(coarse["volume"] / 0.125), atol=1e-9)
    depth = Penetration()(of)
    np.testing.assert_allclose(depth["max"], 10 * halo["depth"])


def test_mean_depth_is_over_the_vertices_inside():
    """A box pushed 4 mm into a wide slab: the four corners of one face are in, all at that depth."""
    slab, box = trimesh.creation.box((0.2, 0.2, 0.02)), trimesh.creation.box((0.02, 0.02, 0.04))
    hands = moved(Mesh(box.vertices, box.faces), (0, 0, 0.01 + 0.02 - 0.004), (0, 0, 0.05))
    found = Penetration()(scene(Mesh(slab.vertices, slab.faces), hands))
    np.testing.assert_allclose(found["max"], [4, 0], atol=1e-3)
    np.testing.assert_allclose(found["mean"], [4, 0], atol=1e-3)


def test_an_open_hand_is_measured_as_the_closed_one(hand):
    """The volume of a hand within a block is that of its capped mesh, right or left or inside out."""
    block = trimesh.creation.box((0.4, 0.4, 0.4))
    solid = Mesh(block.vertices, block.faces)
    for model in (hand, HandModel.open("left")):
        flat = posed(model)
        fan = [[rim[0], b, a] for rim in boundary_loops(model.faces.numpy()) for a, b in pairwise(rim[1:])]
        expected = 1e6 * Mesh(flat.vertices[0], np.concatenate([flat.faces, fan])).volume
        assert Halo()(scene(solid, flat))["volume"][0] == pytest.approx(expected, rel=0.01)
        turned = Hands(vertices=flat.vertices, faces=flat.faces[:, ::-1].copy())
        assert Halo()(scene(solid, turned))["volume"][0] == pytest.approx(expected, rel=0.01)


def all_protocols(labels: HandLabels, reference: Hands) -> list:
    return [
        Halo(),
        GraspTTA(),
        Penetration(),
        FingerContact(labels, EPSILON),
        Posture(labels),
        ContactMaps(labels, EPSILON),
        ClosestHand(reference),
    ]


def test_a_hand_far_away_or_a_hundredth_of_its_size_gives_zeros(hand, labels):
    flat = posed(hand)
    reference = Hands(vertices=flat.vertices, faces=flat.faces, sequences=np.array([0]))
    far = Hands(vertices=flat.vertices + np.float32(1), faces=flat.faces, hand_pose=flat.hand_pose)
    away = 0.01 * (flat.vertices - flat.vertices.mean(1, keepdims=True)) + np.float32([0.06, 0, 0])
    tiny = Hands(vertices=away.astype(np.float32), faces=flat.faces, hand_pose=flat.hand_pose)
    for hands in (far, tiny):
        of = scene(ball(0.03), hands)
        for protocol in all_protocols(labels, reference):
            found = protocol(of)
            for name, values in found.items():
                if protocol.name not in ("posture", "table2"):
                    assert not values.any(), (protocol.name, name)
                assert np.isfinite(values).all()


def test_each_grasp_is_measured_by_itself(hand, labels):
    """In any order and in any company the same numbers, to the bit."""
    rng = np.random.default_rng(0)
    flat = posed(hand, 5, index_mcp_flexion=0.6, thumb_mcp=0.4)
    offsets = rng.normal((0.1, 0.03, 0), 0.02, (5, 1, 3))
    vertices = (flat.vertices + offsets).astype(np.float32)
    hands = Hands(vertices=vertices, faces=flat.faces, hand_pose=flat.hand_pose, sequences=np.arange(5))
    order = np.array([3, 1, 4])
    for protocol in all_protocols(labels, hands):
        together, apart = protocol(scene(ball(0.04), hands)), protocol(scene(ball(0.04), hands.select(order)))
        for name in together:
            np.testing.assert_array_equal(together[name][order], apart[name])
    assert ContactMaps(labels, EPSILON)(scene(ball(0.04), hands))["object"].any()


def test_fingers_that_touch(hand, labels):
    """A small ball at the tip of the index finger, and a large one around the whole hand."""
    flat = posed(hand)
    tip = flat.vertices[0, labels.anatomy.tips[FINGERS.index("index")]]
    small = Mesh(ball(0.002).vertices + tip, ball(0.002).faces)
    found = FingerContact(labels, 0.001)(scene(small, flat))
    assert [found[f"touches_{p}"][0] for p in PARTS] == [p == "index" for p in PARTS]
    assert found["fingers"] == 1
    assert found["pinched"] == 0
    assert 0 < found["area"][0] == found["area_index"][0] < 1

    around = FingerContact(labels, 0.001)(scene(ball(0.5), flat))
    assert around["fingers"] == 5
    assert around["pinched"] == 1
    skin = 1e4 * trimesh.Trimesh(flat.vertices[0], flat.faces, process=False).area
    assert around["area"][0] == pytest.approx(skin, rel=1e-5)
    assert sum(around[f"area_{p}"][0] for p in PARTS) == pytest.approx(skin, rel=1e-5)


def test_vertex_areas_share_out_the_surface():
    box = trimesh.creation.box((1, 2, 3)).subdivide()
    areas = vertex_areas(np.stack([box.vertices, 2 * box.vertices]), box.faces)
    np.testing.assert_allclose(areas.sum(1), [22, 88])


def test_meshes_of_other_hands_give_what_does_not_need_fingers(labels):
    found = FingerContact(labels, EPSILON)(scene(ball(0.03), moved(ball(0.02), (0.04, 0, 0))))
    assert found["area"][0] > 0
    assert np.isnan(found["fingers"][0])
    assert labels.keypoints(moved(ball(0.02), (0, 0, 0))) is None
    assert np.isnan(Posture(labels)(scene(ball(0.03), moved(ball(0.02), (0, 0, 0))))["violations"][0])


def test_joint_limits(hand, labels):
    low, high = labels.anatomy.angle_limits.T
    angles = torch.stack([(low + high) / 2, high, high])
    angles[2, labels.anatomy.angle_names.index("ring_pip")] += np.deg2rad(12)
    angles[2, labels.anatomy.angle_names.index("pinky_dip")] += np.deg2rad(0.5)  # within the tolerance
    found = joint_limits(labels, labels.anatomy.hand_pose(angles).numpy())
    np.testing.assert_array_equal(found["violations"], [0, 0, 1])
    np.testing.assert_allclose(found["excess"], [0, 0, 12], atol=0.01)
    np.testing.assert_allclose(found["off_axis"], 0, atol=0.01)


def test_a_hand_through_itself(hand, labels):
    """The flat hand does not overlap itself; a fist bent through its own palm does."""
    flat = posed(hand)
    bent = posed(hand, **{f"{f}_{j}": 1.9 for f in FINGERS[1:] for j in ("mcp_flexion", "pip", "dip")})
    own = [Posture(labels)(scene(ball(0.03), hands))["self_volume"][0] for hands in (flat, bent)]
    assert own[0] < 0.02
    assert own[1] > 1


def test_an_open_object_and_one_of_many_faces(hand, labels):
    """A bowl without a lid, and a ball of 327,680 faces."""
    flat = posed(hand)
    onto = Hands(vertices=flat.vertices - flat.vertices.mean(1, keepdims=True), faces=flat.faces)
    whole, many = ball(0.04, 3), ball(0.04, 7)
    bowl = Mesh(whole.vertices, whole.faces[whole.triangles.mean(1)[:, 2] < 0.02])
    assert not bowl.is_closed
    exact, fine, opened = (Halo(spacing=0.002)(scene(mesh, onto)) for mesh in (whole, many, bowl))
    assert fine["volume"][0] == pytest.approx(exact["volume"][0], rel=0.05)
    assert 0.4 * exact["volume"][0] < opened["volume"][0] < 1.1 * exact["volume"][0]


def test_keypoints_do_not_depend_on_where_the_hand_is(hand, labels):
    flat = posed(hand, index_pip=0.7, thumb_cmc_flexion=0.3)
    turn = trimesh.transformations.random_rotation_matrix(np.array([0.2, 0.7, 0.4]))[:3, :3]
    elsewhere = Hands(vertices=(flat.vertices @ turn.T + 0.3).astype(np.float32), faces=flat.faces)
    here, there = labels.keypoints(flat), labels.keypoints(elsewhere)
    np.testing.assert_allclose(here, there, atol=1e-6)
    np.testing.assert_allclose(here[0, 0], 0, atol=1e-9)
    np.testing.assert_allclose(here[0, 4, 1:], 0, atol=1e-9)  # the middle knuckle along x
    assert np.linalg.norm(here[0, 4]) == pytest.approx(
        np.linalg.norm(hand.rest_joints(hand.v_template)[4] - hand.rest_joints(hand.v_template)[0]), rel=0.05
    )


def test_contact_stays_within_the_closed_wrist(hand, labels):
    """A rod that enters the hand through its open wrist and ends inside: only what is inside is touched."""
    flat = posed(hand)
    closed, faces = flat.closed
    wrist = closed[0, -1]
    inward = flat.vertices[0, labels.finger == -1].mean(0) - wrist
    inward /= np.linalg.norm(inward)
    rod = trimesh.creation.cylinder(0.003, segment=[wrist - 0.05 * inward, wrist + 0.015 * inward], sections=12)
    rod = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(rod.vertices, rod.faces, 0.003))
    thing = Mesh(rod.vertices, rod.faces)
    touched = ContactMaps(labels, EPSILON)(scene(thing, flat))["object"][0] > 0
    depth = -MeshQuery(Mesh(closed[0], faces)).signed_distance(torch.tensor(thing.vertices)).numpy()
    assert touched[depth > 1e-4].all()
    assert not touched[depth < -EPSILON].any()
    assert (depth > 1e-4).sum() > 20
