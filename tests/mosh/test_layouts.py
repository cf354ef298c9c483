"""Layouts and places."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import yaml

from grabnet.body.whole import BodyModel
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh
from grabnet.io.shipped import shipped
from grabnet.mosh.layouts import read_layout, read_object_layouts, spread_markers, write_layout, write_object_layouts
from grabnet.mosh.places import PLACES, Skin
from grabnet.mosh.placing import draw_layout, marker_positions, place_layout
from grabnet.visual.pictures import can_render
from tests.mosh.conftest import LAYOUTS


def test_the_shipped_layout_has_the_markers_of_grab(actor):
    types = actor.layout.types
    assert {t: int((types == t).sum()) for t in ("body", "face", "finger")} == {"body": 49, "face": 14, "finger": 36}
    assert len(read_layout(LAYOUTS / "open_body_plug_in_gait.yaml").markers) == 39
    assert all(m.distance == (0.0095 if m.type == "body" else 0) for m in actor.layout.markers)
    objects = read_object_layouts(LAYOUTS / "open_objects.yaml")
    assert len(objects) >= 51 and all(len(one.labels) >= 8 for one in objects.values())


@pytest.mark.parametrize("name", ["grab99", "plug_in_gait"])
def test_the_helper_places_the_shipped_layouts(name, actor, tmp_path):
    places = yaml.safe_load((shipped("configs") / f"mosh/places/{name}.yaml").read_text())
    layout, comments = place_layout(name, actor.body, places)
    write_layout(tmp_path / "l.yaml", layout, comments)
    assert (tmp_path / "l.yaml").read_text() == (LAYOUTS / f"open_body_{name}.yaml").read_text()
    assert read_layout(tmp_path / "l.yaml", 13718) == layout


def test_places_are_where_their_names_say(actor):
    skin = Skin(actor.body)
    at = {name: skin.vertices[skin.vertex(name)] for name in PLACES}
    for name, place in at.items():
        if name.startswith("left_"):
            mirrored = at[name.replace("left_", "right_")] * [-1, 1, 1]
            assert np.linalg.norm(place - mirrored) < 0.004, name
    assert at["left_knee_outer"][0] > at["left_knee_inner"][0] and at["nose_tip"][2] > at["chin"][2] - 0.03
    assert at["left_temple"][1] > at["left_jaw"][1] > at["nape"][1] > at["left_hip_front"][1] > at["left_heel"][1]
    assert at["left_index3"][0] > at["left_index2"][0] > at["left_index1"][0] > at["left_wrist_thumb_side"][0]
    with pytest.raises(UserError, match="no place 'left_kneee'"):
        skin.vertex("left_kneee")


def test_a_label_that_the_layout_lacks_is_named_with_its_nearest(actor):
    labels = [*actor.layout.labels]
    labels[labels.index("LKNE")] = "LKNEE"
    with pytest.raises(UserError, match=r"has a marker 'LKNEE', which layout .* lacks; its nearest is 'LKNE'"):
        actor.layout.restricted(labels, "f.c3d")
    layout, notes = actor.layout.restricted([*actor.layout.labels[:60], "Extra"], "f.c3d")
    assert len(layout.markers) == 60 and "no place for Extra" in notes[0] and notes[1].startswith("f.c3d has no ")
    with pytest.raises(UserError, match="shares 0 labels"):
        actor.layout.restricted(["A", "B"], "f.c3d")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("name: x\nvertices: 10\nmarkers: {A: {type: nose, vertex: 1}}", "of type 'nose'"),
        ("name: x\nvertices: 10\nmarkers: {A: {vertex: 10}}", "not on a body of 10 vertices"),
        ("name: x\nvertices: 10\nmarkers: {A: {vertex: true.5}}", "not on a body"),
        ("name: x\nvertices: 10\nmarkers: {A: {}}", "needs a vertex, or a face"),
        ("name: x\nvertices: 10\nmarkers: {A: {corners: [1, 2, 3], weights: [1, 1, 1]}}", "whose sum is 1"),
        ("name: x\nvertices: 10\nmarkers: {A: {vertex: 1, distance: 9.5}}", "must be metres"),
        ("name: x\nmarkers: {A: {vertex: 1}}", "lacks the number of vertices"),
        ("name: x\nvertices: 10", "has no markers"),
        ("- a", "must be a mapping"),
        ("a: [", "is no YAML"),
    ],
)
def test_layouts_that_cannot_be(tmp_path, text, sentence):
    (tmp_path / "l.yaml").write_text(text)
    with pytest.raises(UserError, match=sentence):
        read_layout(tmp_path / "l.yaml")


def test_a_layout_is_for_one_body_model(actor):
    with pytest.raises(UserError, match=r"a body model of 13,718 vertices; this one has 10,475"):
        read_layout(LAYOUTS / "open_body_grab99.yaml", 10475)


def test_markers_lie_at_their_distance_from_the_skin(actor):
    rest = actor.body.v_template.double().numpy()
    outward = np.tile([0.0, 1.0, 0.0], (len(rest), 1))
    off = marker_positions(actor.layout, rest, outward) - rest[[m.vertices[0] for m in actor.layout.markers]]
    np.testing.assert_allclose(off[:, 1], [m.distance for m in actor.layout.markers], atol=1e-12)


def test_markers_of_objects_are_spread_and_come_back(tmp_path):
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
    faces = [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2],
             [2, 4, 6], [1, 3, 5], [3, 7, 5]]  # fmt: skip
    layout = spread_markers("box", Mesh(corners, np.array(faces)), 8)
    distance = torch.pdist(torch.as_tensor(layout.positions))
    assert distance.min() > 0.6, "one near each corner"
    write_object_layouts(tmp_path / "o.yaml", [layout])
    found = read_object_layouts(tmp_path / "o.yaml")["box"]
    assert found.labels == layout.labels
    np.testing.assert_allclose(found.positions, layout.positions, atol=1e-5)
    (tmp_path / "o.yaml").write_text("box: {m1: [1, 2], m2: [0, 0, 0], m3: [1, 1, 1]}")
    with pytest.raises(UserError, match="m1 of box must be a position"):
        read_object_layouts(tmp_path / "o.yaml")


@pytest.mark.skipif(bool(can_render()), reason="no OpenGL")
def test_a_layout_is_drawn_as_picture_and_page(tmp_path, actor):
    assert draw_layout(tmp_path / "l.png", actor.layout, BodyModel.open(), actor.guess) is None
    assert (tmp_path / "l.png").stat().st_size > 10_000
    page = (tmp_path / "l.html").read_text()
    assert all(f"<td>{label}<td>" in page for label in actor.layout.labels)
