"""Layouts and places."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from hydra.utils import instantiate
from PIL import Image

from grabnet.body.hand import OPEN_HANDS
from grabnet.body.whole import OPEN_BODY, BodyModel
from grabnet.cli.entry import compose
from grabnet.data.sequences import load_below, read_sequence
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh
from grabnet.io.shipped import shipped
from grabnet.mosh import layout_commands
from grabnet.mosh.layout_commands import DrawConfig, PlaceConfig, read_places
from grabnet.mosh.layouts import read_layout, read_object_layouts, spread_markers, write_layout, write_object_layouts
from grabnet.mosh.places import PLACES, Skin
from grabnet.mosh.placing import TYPE_COLORS, marker_positions, place_layout
from grabnet.mosh.run import run
from grabnet.visual.pictures import can_render
from tests.mosh.conftest import LAYOUTS, write_csv
from tests.readme import ROOT, blocks


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
    with pytest.raises(UserError, match="no place 'left_kneee'; its nearest is 'left_knee_"):
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
        ("name: x\nvertices: 10\nmarkers: {A: {corners: [1, 2, 3], weights: [.nan, 0, 1]}}", "from 0 to 1"),
        ("name: x\nvertices: 10\nmarkers: {A: {corners: [1, 2, 3], weights: [5, -4, 0]}}", "from 0 to 1"),
        ("name: x\nvertices: 10\nmarkers: {A: {type: [body], vertex: 1}}", r"of type '\['body'\]'"),
        ("name: x\nvertices: 10\nmarkers: {1: {vertex: 1}, '1': {vertex: 2}}", "'1' occurs twice"),
        ("name: x\nvertices: 10\nmarkers: {A: {vertex: 1, distance: 9.5}}", "must be metres"),
        ("name: x\nmarkers: {A: {vertex: 1}}", "lacks the number of vertices"),
        ("name: x\nvertices: 10", "has no markers"),
        ("- a", "must be a mapping"),
        ("a: [", "is no YAML"),
        ("name: x\nvertices: 10\nmarkers: {A: {vertex: 1}, A: {vertex: 2}}", "'A' occurs twice"),
        ("name: x\nvertices: 10\nmarkers: {NO: {vertex: 1}}", "'NO' is not read as a name: put it in quotes"),
        ("name: x\nvertices: 10\nmarkers: {[1]: {vertex: 1}}", "is no name"),
    ],
)
def test_layouts_that_cannot_be(tmp_path, text, sentence):
    (tmp_path / "l.yaml").write_text(text)
    with pytest.raises(UserError, match=sentence):
        read_layout(tmp_path / "l.yaml")


def test_small_numbers_come_back(tmp_path, actor):
    """Those that would be written with an exponent, and weights beside 0 by rounding."""
    first = replace(actor.layout.markers[0], vertices=(1, 2, 3), weights=(-2e-6, 0.400002, 0.6), distance=1e-5)
    layout = replace(actor.layout, markers=(first, *actor.layout.markers[1:]))
    write_layout(tmp_path / "l.yaml", layout)
    assert read_layout(tmp_path / "l.yaml") == layout


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


class Turned:
    """The open body and hands as files of smplx's models: the body's vertices in another order, under other names."""

    def __init__(self, folder: Path):
        content = dict(np.load(OPEN_BODY / "SMPLX_NEUTRAL.npz"))
        n = len(content["v_template"])
        self.order = np.random.default_rng(0).permutation(n)  # of each vertex, which it is in the open body
        content["f"] = np.argsort(self.order)[content["f"]]
        for name in ("v_template", "shapedirs", "posedirs", "weights"):
            content[name] = content[name][self.order]
        content["J_regressor"] = content["J_regressor"][:, self.order]
        for name in ("lmk_faces_idx", "lmk_bary_coords"):
            del content[name]
        (folder / "smplx").mkdir(parents=True)
        (folder / "mano").mkdir()
        np.savez(folder / "smplx/SMPLX_FEMALE.npz", **content)
        for side in ("LEFT", "RIGHT"):
            shutil.copyfile(OPEN_HANDS / f"MANO_{side}.npz", folder / f"mano/MANO_{side}.npz")
        self.models, self.body = str(folder), BodyModel(folder / "smplx/SMPLX_FEMALE.npz")


@pytest.fixture(scope="module")
def turned(tmp_path_factory) -> Turned:
    return Turned(tmp_path_factory.mktemp("models"))


def test_any_model_in_the_schema_takes_its_own_layout(turned, actor, tmp_path, capsys):
    out = tmp_path / "own.yaml"
    assert layout_commands.place(PlaceConfig("grab99", "female", None, turned.models, str(out))) == 0
    assert "99 markers are in" in capsys.readouterr().out
    found = read_layout(out, len(turned.body.v_template))
    same = [turned.order[marker.vertices[0]] for marker in found.markers]
    assert same == [marker.vertices[0] for marker in actor.layout.markers], "the same places of the same body"
    assert "# left knee outer" in out.read_text()
    page = (tmp_path / "own.html").read_text()
    assert all(f"<td>{marker.label}<td>{marker.type}<td>" in page for marker in found.markers) and "49 body" in page
    if can_render() is None:
        picture = np.asarray(Image.open(tmp_path / "own.png"))
        shade = picture.max(-1, keepdims=True)
        for color in TYPE_COLORS.values():  # balls of this hue, lighter and darker
            off = np.abs(picture / np.maximum(shade, 1) - np.array(color) / max(color)).max(-1)
            assert ((off < 0.12) & (shade[..., 0] > 60) & (shade[..., 0] < 250)).sum() > 50, color
    with pytest.raises(UserError, match=r"holds neither SMPLX_MALE nor smplx/SMPLX_MALE"):
        layout_commands.place(PlaceConfig("grab99", "male", None, turned.models, str(out)))


def test_a_capture_is_solved_with_a_model_and_a_layout_of_ones_own(turned, actor, tmp_path):
    out = tmp_path / "own.yaml"
    write_layout(out, place_layout("own", turned.body, read_places("grab99")[1])[0])
    write_csv(tmp_path / "x_lift_1.csv", [*actor.layout.labels], actor.markers[:8])
    values = [
        f"capture={tmp_path / 'x_lift_1.csv'}", f"layout={out}", f"models={turned.models}", "gender=female",
        f"out={tmp_path / 'out'}", "workers=1", "pictures=false", "stage_one.iterations=4", "stage_one.frames=4",
        "stage_one.annealing=[1.0]",
    ]  # fmt: skip
    assert run(instantiate(compose("mosh/mosh", values), _convert_="all")) == 0
    sequence = read_sequence(tmp_path / "out/grab/s1/x_lift_1.npz")
    rest = torch.tensor(load_below(tmp_path / "out", sequence.body.vtemp, mend=False).vertices)
    skin = turned.body(sequence.body.parameters(), rest).vertices
    assert 1e3 * (skin - actor.vertices[:8, turned.order]).norm(dim=-1).mean() < 5


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("body: {A: left_kneee}", "no place 'left_kneee'; its nearest is"),
        ("body: {A: 7}", "the place of A is 7; it must be a name"),
        ("leg: {A: chin}", "'leg' must be body, face, finger, with label: place below it"),
        ("body: {}", "has no markers"),
        ("{}", "has no markers"),
        ("body: {1: chin, '1': nose_tip}", "'1' occurs twice"),
        ("body: chin", "'body' must be body, face, finger"),
        ("body: {A: chin, B: chin}", "A and B are both at chin"),
        ("body: {A: chin}\nface: {A: nose_tip}", "has a label in two types"),
        ("body: {A: chin, A: nose_tip}", "'A' occurs twice"),
        ("- a", "must be a mapping"),
        ("", "must be a mapping"),
    ],
)
def test_places_that_cannot_be(tmp_path, text, sentence):
    (tmp_path / "p.yaml").write_text(text)
    with pytest.raises(UserError, match=sentence):
        layout_commands.place(PlaceConfig(str(tmp_path / "p.yaml"), "neutral", None, None, str(tmp_path / "out.yaml")))
    assert not (tmp_path / "out.yaml").exists()


def test_the_examples_of_the_document_are_as_files_are(actor, tmp_path):
    layout, places = blocks("yaml", (ROOT / "docs/mosh.md").read_text())
    (tmp_path / "l.yaml").write_text(layout)
    found = {marker.label: marker for marker in read_layout(tmp_path / "l.yaml", 13718).markers}
    shipped_ = {marker.label: marker for marker in actor.layout.markers}
    assert found["LKNE"] == shipped_["LKNE"] and found["NOSE"] == shipped_["NOSE"]
    assert found["LIND3"].weights == (0.2, 0.3, 0.5) and found["LIND3"].distance == 0.001
    (tmp_path / "p.yaml").write_text(places)
    assert read_places(str(tmp_path / "p.yaml"))[1]["face"] == {"NOSE": "nose_tip"}


def test_labels_that_are_numbers_are_names(tmp_path):
    (tmp_path / "p.yaml").write_text("body: {1: left_knee_outer}")
    assert read_places(str(tmp_path / "p.yaml"))[1] == {"body": {"1": "left_knee_outer"}}


@pytest.mark.parametrize("output", ["x.png", "x.PNG", "x.html"])
def test_a_layout_is_not_named_as_its_picture_or_page(output):
    with pytest.raises(UserError, match=f"output is '{output}'; it cannot end in .png or .html"):
        PlaceConfig("grab99", "neutral", None, None, output)


def test_sets_that_do_not_ship_are_refused_by_name():
    with pytest.raises(
        UserError, match="markers is 'grab', which is no file; those that ship are grab99, plug_in_gait"
    ):
        read_places("grab")


def test_layouts_are_drawn_and_pages_quote_them(tmp_path, actor, capsys):
    """Names that YAML and HTML read as something else come through both."""
    labels = ["<b>'", "NO", "1", "a: b", "#x", "é"]
    markers = tuple(replace(marker, label=label) for marker, label in zip(actor.layout.markers, labels, strict=False))
    odd = replace(actor.layout, name="<script>", markers=markers)
    write_layout(tmp_path / "l.yaml", odd)
    assert read_layout(tmp_path / "l.yaml") == odd
    config = DrawConfig(str(tmp_path / "l.yaml"), "neutral", None, None, str(tmp_path / "l.png"))
    assert layout_commands.draw(config) == 0 and "l.html lists them" in capsys.readouterr().out
    page = (tmp_path / "l.html").read_text()
    assert "<script>" not in page and "<b>" not in page and "&lt;b&gt;&#x27;" in page and "<td>a: b<td>" in page
