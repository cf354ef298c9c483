"""Left hands in the mirror are right hands: as posed, as they touch, and in every label."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
import trimesh
from scipy.spatial.transform import Rotation

from grabnet.body.hand import HandModel
from grabnet.contact.annotator import ContactAnnotator
from grabnet.data.sources.base import shard_values
from grabnet.geometry.mesh import Mesh
from grabnet.preprocess.grasp_track import GraspTrack, mirror_image, mirrored
from grabnet.preprocess.heights import gap_to_table
from tests.data.grab import random_sequence

FLIP = np.array([-1, 1, 1])


def test_contact_of_the_mirrored_scene_is_identical():
    """Through the store's own values: pose, translation and object of each frame, against the left hand as recorded."""
    left, right = HandModel.open("left"), HandModel.open("right")
    spoon = trimesh.util.concatenate(
        [
            trimesh.creation.box((0.02, 0.1, 0.03)),
            trimesh.creation.icosphere(3, 0.03).apply_translation([0.02, 0.06, 0.01]),
        ]
    )
    spoon = Mesh(*trimesh.remesh.subdivide_to_size(spoon.vertices, spoon.faces, 0.004))
    made = random_sequence(6, len(spoon.vertices))
    template = left.shaped(torch.tensor([1.0, -1.0]))
    posed = left(made.lhand.parameters(), template).vertices
    # The thing is where the hand is.
    middle = posed.mean(1).numpy() - spoon.centroid
    made = replace(made, object=replace(made.object, transl=middle.astype(np.float32)))
    track = GraspTrack.left_mirrored(made)
    reflected = mirror_image(Mesh(template, left.faces))
    values = shard_values(track.frames(np.arange(6)), mirrored(spoon.centroid))
    turns = Rotation.from_rotvec(values["object_orient"].numpy()).as_matrix()
    again = right(
        track.hand.parameters()._replace(transl=values["transl"]), torch.tensor(reflected.vertices)
    ).vertices.numpy()
    image = mirror_image(spoon)
    parts = 1 + left.weights.argmax(1).numpy()
    as_recorded = ContactAnnotator(spoon, template.numpy(), left.faces.numpy(), parts)
    in_mirror = ContactAnnotator(image, reflected.vertices, right.faces.numpy(), 1 + right.weights.argmax(1).numpy())
    touched = 0
    for k in range(6):
        expected = as_recorded(made.object.to_local(posed)[k].numpy())
        found = in_mirror((again[k] @ turns[k] + image.centroid).astype(np.float32))
        assert (expected.object != found.object).sum() <= 1 and (expected.body != found.body).sum() <= 1  # rounding
        touched += (found.object > 0).sum()
    assert touched > 100


def test_labels_change_sides():
    made = random_sequence(1, 56)
    made = replace(made, contact=replace(made.contact, object=np.arange(56, dtype=np.uint8)[None]))
    swapped = GraspTrack.left_mirrored(made).labels[0]
    assert (swapped[26:41] == np.arange(41, 56)).all() and (swapped[41:56] == np.arange(26, 41)).all()
    assert (swapped[[21, 22]] == [22, 21]).all() and (swapped[[0, 1, 4, 16, 23]] == [0, 1, 4, 16, 23]).all()
    assert (swapped[swapped] == np.arange(56)).all()


def test_a_mirrored_mesh_faces_outwards():
    cone = trimesh.creation.cone(0.02, 0.05)
    cone.apply_translation([0.03, 0, 0])
    image = mirror_image(Mesh(cone.vertices, cone.faces))
    assert image.is_closed and np.isclose(image.volume, cone.volume, rtol=1e-5)
    np.testing.assert_allclose(image.vertices, cone.vertices * FLIP, atol=1e-7)


def test_the_gap_to_the_table_is_that_of_the_extreme_vertices():
    made, rng = random_sequence(5), np.random.default_rng(3)
    thing, table = (Mesh(rng.normal(0, size, (30, 3)), np.arange(30).reshape(10, 3)) for size in (0.1, 0.5))
    gap = gap_to_table(made.object, thing, made.table, table)
    for k in range(5):
        low, high = (
            (mesh.vertices @ Rotation.from_rotvec(track.global_orient[k]).as_matrix() + track.transl[k])[:, 2]
            for mesh, track in ((thing, made.object), (table, made.table))
        )
        assert np.isclose(gap[k], low.min() - high.max(), atol=1e-5)
