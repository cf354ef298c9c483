"""Contact maps of samples against distances of all vertices, in meshes of any frame and units, for either hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import cKDTree

from grabnet.body.anatomy import Anatomy
from grabnet.body.skeleton import LEFT_HAND_PARTS, RIGHT_HAND_PARTS
from grabnet.contact.coloured import PART_COLOURS
from grabnet.contact.rules import ContactRules
from grabnet.generation.contact_maps import contact_maps
from grabnet.generation.export import write_grasps
from grabnet.generation.grasps import Grasps
from grabnet.geometry.mesh import Mesh

# Millimetres, y up.
TO_OBJECT = np.array([[0.001, 0, 0, -0.3], [0, 0, -0.001, 0.1], [0, 0.001, 0, 0.2], [0, 0, 0, 1]])
EPSILON = 0.0045


@pytest.fixture(scope="module", params=["right", "left"])
def grasps(request, grabber, cache_dir) -> Grasps:
    """Hands that hover 1, 3 and 6 mm over a box."""
    box = trimesh.creation.box((0.12, 0.16, 0.03))
    box = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(box.vertices, box.faces, 0.004), process=True)
    solid = Mesh(box.vertices, box.faces)
    to_mesh = np.linalg.inv(TO_OBJECT)
    made = grabber(solid.transformed(to_mesh), 3, 5, request.param, to_object=TO_OBJECT, cache_dir=cache_dir)
    mirror = np.array([1 if request.param == "right" else -1, 1, 1])
    palm_down = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    hand = (grabber.hand.v_template.double().numpy() * mirror) @ palm_down.T
    hand -= [*hand[:, :2].mean(0), hand[:, 2].min() - solid.bounds[1, 2]]
    hands = hand + np.array([0.001, 0.003, 0.006])[:, None, None] * [0, 0, 1]
    in_mesh = hands @ to_mesh[:3, :3].T + to_mesh[:3, 3]
    return replace(made, vertices=torch.tensor(in_mesh, dtype=torch.float32))


def in_metres(points: np.ndarray) -> np.ndarray:
    return np.asarray(points, float) @ TO_OBJECT[:3, :3].T + TO_OBJECT[:3, 3]


def test_what_lies_within_reach_touches(grasps, grabber):
    maps = contact_maps(grasps, grabber.hand, ContactRules("vertices", "skinning"))
    labels = LEFT_HAND_PARTS if grasps.side == "left" else RIGHT_HAND_PARTS
    parts = np.array(labels)[Anatomy.of(grabber.hand).bone]
    solid = in_metres(grasps.mesh.vertices)
    for hand, on_object, on_hand in zip(in_metres(grasps.vertices), *maps, strict=True):
        to_hand, to_object = cKDTree(hand).query(solid)[0], cKDTree(solid).query(hand)[0]
        clear, hand_clear = (np.abs(d - EPSILON) > 1e-6 for d in (to_hand, to_object))
        np.testing.assert_array_equal((on_object > 0)[clear], (to_hand < EPSILON)[clear])
        np.testing.assert_array_equal(on_hand[hand_clear], np.where(to_object < EPSILON, parts, 0)[hand_clear])
        assert set(np.unique(on_object)) <= {0, *labels}
    assert [bool(m.any()) for m in maps.object] == [True, True, False]


@pytest.mark.parametrize("part_by", ["skinning", "bone"])
def test_a_left_hand_touches_as_its_mirror_image(grasps, grabber, part_by):
    """Mirrored in the object's plane x = 0, in which the box is its own image."""
    rules = ContactRules("surface", part_by)
    maps = contact_maps(grasps, grabber.hand, rules)
    flip = np.linalg.inv(TO_OBJECT) @ np.diag([-1.0, 1, 1, 1]) @ TO_OBJECT
    mirrored = replace(
        grasps,
        side="left" if grasps.side == "right" else "right",
        mesh=Mesh(grasps.mesh.vertices @ flip[:3, :3].T + flip[:3, 3], grasps.mesh.faces[:, ::-1]),
        vertices=torch.tensor(grasps.vertices.numpy() @ flip[:3, :3].T + flip[:3, 3], dtype=torch.float32),
        faces=grasps.faces.flip(1),
    )
    image = contact_maps(mirrored, grabber.hand, rules)
    there, here = (LEFT_HAND_PARTS, RIGHT_HAND_PARTS) if grasps.side == "right" else (RIGHT_HAND_PARTS, LEFT_HAND_PARTS)
    renamed = np.zeros(56, np.uint8)
    renamed[list(there)] = here
    agree = renamed[image.object] == maps.object
    assert agree.mean() > 0.999 and maps.object.any()  # rounding decides on ε, and on the bone at a joint
    np.testing.assert_array_equal(renamed[image.hand] > 0, maps.hand > 0)


def test_results_hold_the_maps(grasps, grabber, tmp_path):
    maps = contact_maps(grasps, grabber.hand, ContactRules())
    write_grasps(tmp_path / "out", grasps, {"name": "a"}, ["ply"], sheet=0, page=0, contact=maps)
    with np.load(tmp_path / "out/contact.npz") as stored:
        np.testing.assert_array_equal(stored["object"], maps.object)
        np.testing.assert_array_equal(stored["hand"], maps.hand)
    solid, hand = (trimesh.load(tmp_path / f"out/contact/{name}_000.ply", process=False) for name in ("object", "hand"))
    np.testing.assert_array_equal(solid.vertices.astype(np.float32), grasps.mesh.vertices)
    np.testing.assert_array_equal(hand.vertices.astype(np.float32), grasps.vertices[0])
    np.testing.assert_array_equal(hand.visual.vertex_colors[:, :3], PART_COLOURS[maps.hand[0]])
    # Results without maps leave none of earlier ones behind.
    write_grasps(tmp_path / "out", grasps, {"name": "a"}, [], sheet=0, page=0)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["grasps.json", "grasps.npz"]
