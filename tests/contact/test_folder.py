"""Recomputed contact on disk: what a reader of GRAB finds, and what the dense correspondence says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from grabnet.contact.annotator import ContactAnnotator
from grabnet.contact.coloured import PART_COLOURS
from grabnet.contact.folder import ContactFolder
from grabnet.contact.sequences import Annotation, TouchedFrame
from grabnet.data.sequences import ContactTrack, read_sequence
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh
from tests.contact.test_annotator import INDEX, finger, plate
from tests.data.grab import random_sequence

TIPS = ([0.001, -0.002, 0.2], [0.001, -0.002, -0.004], [-0.003, 0.004, 0.003])  # away, in the plate, above it


@pytest.fixture(scope="module")
def found():
    """Object, bodies frame by frame, and what touches."""
    thing, bodies = plate(), [finger(np.array(tip)) for tip in TIPS]
    mesh = Mesh(thing.vertices, thing.faces)
    parts = np.full(len(bodies[0].vertices), INDEX)
    annotator = ContactAnnotator(mesh, bodies[0].vertices, bodies[0].faces, parts)
    return mesh, bodies, [annotator(body.vertices) for body in bodies]


@pytest.fixture(scope="module")
def sequence(found):
    labels = ContactTrack(*(np.stack([getattr(c, side) for c in found[2]]) for side in ("object", "body")))
    return replace(random_sequence(3), contact=labels)


@pytest.fixture(scope="module")
def folder(found, sequence, tmp_path_factory):
    folder = ContactFolder(tmp_path_factory.mktemp("contact"))
    folder.start({"every": 1})
    assert not folder.holds(sequence.name)
    folder.write(sequence, Annotation(sequence.contact, [TouchedFrame.of(contact) for contact in found[2]]))
    assert folder.holds(sequence.name)
    return folder


def test_recordings_are_as_grab_has_them(folder, sequence):
    path = folder.root / "grab" / f"{sequence.name}.npz"
    again = read_sequence(path)
    np.testing.assert_array_equal(again.contact.object, sequence.contact.object)
    np.testing.assert_array_equal(again.contact.body, sequence.contact.body)
    np.testing.assert_array_equal(again.body.fullpose, sequence.body.fullpose)
    with np.load(path, allow_pickle=True) as stored:  # as its users read it
        contact = stored["contact"].item()
    assert (contact["object"][1:] > 0).any(1).all() and set(np.unique(contact["object"])) == {0, INDEX}
    assert not contact["object"][0].any()


def test_correspondence_says_which_point_of_the_body_a_vertex_meets(folder, sequence, found):
    mesh, bodies, _ = found
    with np.load(folder.root / "correspondence" / f"{sequence.name}.npz") as stored:
        face, barycentric = stored["face"], stored["barycentric"]
    assert face.shape == (3, len(mesh.vertices)) and face.dtype == np.int32
    assert barycentric.shape == (3, len(mesh.vertices), 3) and barycentric.dtype == np.float32
    touched = sequence.contact.object > 0
    np.testing.assert_array_equal(face >= 0, touched)
    assert (face[~touched] == -1).all() and np.isnan(barycentric[~touched]).all()
    for body, here, faces, weights in zip(bodies[1:], touched[1:], face[1:], barycentric[1:], strict=True):
        points = (body.triangles[faces[here]] * weights[here][..., None]).sum(1)
        in_mm = body.copy().apply_scale(1000)
        expected, _, _ = trimesh.proximity.closest_point_naive(in_mm, 1000.0 * mesh.vertices[here])
        np.testing.assert_allclose(1000 * points, expected, atol=2e-3)


def test_the_same_contact_gives_the_same_bytes(folder, sequence, found, tmp_path):
    again = ContactFolder(tmp_path)
    again.write(sequence, Annotation(sequence.contact, [TouchedFrame.of(contact) for contact in found[2]]))
    files = [path.relative_to(tmp_path) for path in tmp_path.rglob("*.npz")]
    assert len(files) == 2
    for path in files:
        assert (tmp_path / path).read_bytes() == (folder.root / path).read_bytes()


def test_a_frame_as_meshes_in_the_world(folder, sequence, found):
    mesh, bodies, contacts = found
    in_world = torch.tensor(bodies[1].vertices).float()
    folder.write_frame(sequence, 1, mesh, in_world, bodies[1].faces)
    place = folder.root / "frames" / f"{sequence.name}_1"
    solid = trimesh.load(place.with_name(f"{place.name}_object.ply"), process=False)
    rotation = sequence.object.rotations()[1].double().numpy()
    np.testing.assert_allclose(solid.vertices, mesh.vertices @ rotation.T + sequence.object.transl[1], atol=1e-6)
    body = trimesh.load(place.with_name(f"{place.name}_body.ply"), process=False)
    np.testing.assert_allclose(body.vertices, in_world, atol=1e-6)
    for part, labels in ((solid, contacts[1].object), (body, contacts[1].body)):
        np.testing.assert_array_equal(part.visual.vertex_colors[:, :3], PART_COLOURS[labels])
        stored = part.metadata["_ply_raw"]["vertex"]["data"]["contact"]
        np.testing.assert_array_equal(np.ravel(stored), labels)


def test_parts_have_colours_of_their_own():
    assert len({tuple(colour) for colour in PART_COLOURS}) == 56


def test_contact_found_otherwise_is_not_mixed_in(folder):
    ContactFolder(folder.root).start({"every": 1})
    with pytest.raises(UserError, match=r"was started with every=1, now it is 2: delete .*, or choose another folder"):
        ContactFolder(folder.root).start({"every": 2})
