"""Exported studies: films, names, catch trials, lists."""

from __future__ import annotations

import json
import re
import stat
from collections import Counter

import av
import numpy as np
import pytest
import trimesh

from grabnet.body.hand import HandModel
from grabnet.errors import UserError
from grabnet.evaluation.hands import Hands
from grabnet.geometry.mesh import Mesh
from grabnet.study.catches import CatchConfig, Catches
from grabnet.study.films import Set
from grabnet.study.key import CATCH, EXAMPLE, StudyKey
from grabnet.study.store import AnswerStore
from grabnet.study.trials import balanced_lists
from grabnet.visual.turntable import FilmConfig
from tests.study.conftest import made_key


def decoded(path) -> list[np.ndarray]:
    with av.open(str(path)) as film:
        assert film.streams.video[0].codec_context.name == "h264"
        assert film.streams.video[0].average_rate == 12
        return [frame.to_ndarray(format="rgb24").astype(int) for frame in film.decode(video=0)]


@pytest.mark.parametrize("name", ["Catch", "example"])
def test_a_condition_that_is_named_as_a_part_of_every_study_is_refused(export_study, name, tmp_path):
    """Its grasps would count as catch trials, or would never be rated."""
    hands = tmp_path / name / "ring"
    hands.mkdir(parents=True)
    for k in range(2):
        trimesh.creation.box((0.1, 0.1, 0.1)).export(hands / f"{k}.ply")
    with pytest.raises(UserError, match=f"A condition is named '{name}', as a part of every study is"):
        export_study(tmp_path / "out", f"grasps={tmp_path / name}", f"conditions=[Ground truth,{name}]")


def test_films_show_hand_and_object_whole_and_all_the_way_round(rating_study):
    key = StudyKey.read(rating_study)
    assert Counter(shown.condition for shown in key.videos.values()) == {
        "Ground truth": 2, "Naive baseline": 2, CATCH: 2, EXAMPLE: 2,
    }  # fmt: skip
    for name in key.videos:
        frames = decoded(rating_study / f"site/videos/{name}.mp4")
        assert len(frames) == 6 and frames[0].shape == (96, 96, 3)
        for frame in frames:
            skin = frame[..., 0] - frame[..., 2] > 25
            blue = frame[..., 2] - frame[..., 0] > 12
            assert skin.sum() > 60 and blue.sum() > 15  # the hand may hide much of the ring
            edge = np.concatenate([frame[0], frame[-1], frame[:, 0], frame[:, -1]])
            assert edge.min() > 225  # nothing but the background
        assert abs(frames[0] - frames[3]).mean() > 2  # it turns
        assert (rating_study / f"site/posters/{name}.jpg").stat().st_size > 500


def test_nothing_that_is_served_tells_what_a_video_shows(rating_study):
    site, private = rating_study / "site", rating_study / "private"
    for path in [*site.rglob("*.json"), *(p for folder in ("videos", "posters") for p in (site / folder).iterdir())]:
        content = path.read_bytes().lower()
        assert not any(word in content + path.name.encode() for word in (b"truth", b"naive", b"baseline", b"catch"))
    films = [*(site / "videos").iterdir(), *(site / "posters").iterdir()]
    assert {path.stat().st_mtime for path in films} == {0}
    assert {len(path.stem) for path in films} == {20}
    assert stat.S_IMODE((private / "key.json").stat().st_mode) == 0o600
    assert stat.S_IMODE((private / "secret").stat().st_mode) == 0o600
    assert stat.S_IMODE(private.stat().st_mode) == 0o700
    study = json.loads((site / "study.json").read_text())
    often = Counter(name for trials in study["lists"] for (name,) in trials)
    assert set(often.values()) == {2}  # catch trials are not shown more or less often


def test_an_export_carries_the_licence_of_all_that_it_brings(rating_study):
    bundled = rating_study / "site/jspsych"
    licence = (bundled / "LICENSE").read_text()
    scripts = {path.name for path in bundled.glob("*.js")}
    assert scripts == {"jspsych.js", "plugin-html-button-response.js"} and all(name in licence for name in scripts)
    # By the authors' own files: jsPsych, and what its bundle contains.
    for holder in ("2014-2022 Joshua R. de Leeuw", "Sindre Sorhus", "2013 P'unk Avenue LLC", "2019 David Bau",
                   "2010 by Johannes Baagøe"):  # fmt: skip
        assert re.search(rf"Copyright (\([cC]\) )?{holder}", licence)
    assert "MIT licence" in licence and "Permission is hereby granted, free of charge" in licence
    for name, version in (("jspsych.js", "8.3.0"), ("plugin-html-button-response.js", "2.1.0")):
        assert f'"{version}"' in (bundled / name).read_text() and version in licence


def test_an_export_goes_on_where_it_was_stopped(export_study, rating_study, copied, capsys):
    folder = copied(rating_study)
    before = {path.name: path.read_bytes() for path in (folder / "site/videos").iterdir()}
    lost = min(before)
    film = decoded(folder / "site/videos" / lost)
    (folder / "site/videos" / lost).unlink()
    (folder / "site/videos/.half-abcdefgh.mp4").write_text("half")
    export_study(folder)
    assert "8 videos, 1 of them new" in capsys.readouterr().out
    assert abs(np.array(decoded(folder / "site/videos" / lost)) - film).mean() < 0.5  # x264 varies by some bytes
    after = {path.name: path.read_bytes() for path in (folder / "site/videos").iterdir()}
    assert after.keys() == before.keys() and before | {lost: after[lost]} == after


def test_answers_to_another_study_are_not_orphaned(export_study, rating_study, copied):
    folder = copied(rating_study)
    (folder / "private/answers.jsonl").write_text("{}\n")
    with pytest.raises(UserError, match="holds answers to the study as it was before: choose another output"):
        export_study(folder, "lists=3")
    (folder / "private/secret").write_text("")  # names would be known to everybody
    with pytest.raises(UserError, match="secret is damaged"):
        export_study(folder)


def test_a_study_that_is_served_is_not_exported_again(export_study, rating_study, copied):
    folder = copied(rating_study)
    with (
        AnswerStore(folder / "private/answers.jsonl"),
        pytest.raises(UserError, match=r"answers.jsonl is in use by another server"),
    ):
        export_study(folder, "lists=3")


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        (["conditions=[Ground truth,Nobody]"], "conditions names 'Nobody'; the rows are Ground truth; Naive baseline"),
        (["conditions=[Ground truth]"], "at least two different rows"),
        (["n=500"], "grasps of ring; n asks for 500"),
        (["objects=[cup]"], "cup"),
        (["objects=cup"], "objects is cup; it can be"),
        (["completion_code='x y'"], "completion_code is 'x y'"),
        (["film.size=95"], "film.size is 95; it must be even"),
        (["text.levels=[a,a]"], "2 to 9 different words"),
        (["catch.depth=0"], "depth is 0; it must be above 0"),
    ],
)
def test_what_cannot_be_exported_is_said_in_a_sentence(export_study, tmp_path, values, sentence):
    with pytest.raises(UserError, match=sentence):
        export_study(tmp_path, *values)


def test_catch_trials_are_as_implausible_as_is_recorded():
    """Against the closed formula of a torus."""
    outer, tube = 0.04, 0.012
    ring = trimesh.creation.torus(outer, tube, major_sections=96, minor_sections=48)
    hand = HandModel.open()
    flat = hand.v_template.numpy() - hand.v_template.numpy().mean(0)
    spread = np.linspace(-0.02, 0.02, 8, dtype=np.float32)[:, None, None]
    vertices = (flat + np.array([0.03, 0, 0.03], np.float32) + spread).astype(np.float32)
    truth = Hands(vertices=vertices, faces=hand.faces.numpy(), sequences=np.arange(8))
    config = CatchConfig(depth=0.008, beyond=0.005, gap=0.02, step=0.005, reach=0.15)
    catches = Catches(Mesh(ring.vertices, ring.faces), config, seed=0)
    hands, made = catches.make(truth, 4, seed=0)
    assert [how["kind"] for how in made] == ["through", "apart"] * 2
    assert len({how["source"] for how in made}) == 4
    assert {how["source"] for how in made} == {1, 3, 5, 7}  # held out: every other recording
    for posed, how in zip(hands.astype(float), made, strict=True):
        expected = truth.closed[0][how["source"]] + np.array(how["moved"])
        np.testing.assert_allclose(posed, expected, atol=1e-6)
        distance = np.hypot(np.hypot(posed[:, 0], posed[:, 1]) - outer, posed[:, 2]) - tube
        if how["kind"] == "apart":
            assert how["gap"] >= 0.02 and how["depth"] == 0
            assert distance.min() >= how["gap"] - 5e-4
        else:
            assert how["depth"] >= 0.008 and how["gap"] == 0
            # The hand's surface seen from the ring: the winding number of its triangles about points deep inside.
            assert -distance.min() <= how["depth"] + 5e-4
    with pytest.raises(UserError, match="Only 8 of 20 catch trials"):
        catches.make(truth, 20, seed=0)


def test_every_point_stays_in_view():
    config = FilmConfig(
        size=64, seconds=1, fps=24, elevation=35.0, view_angle=40.0, margin=0.1, supersampling=1, faces=500, quality=23
    )
    rng = np.random.default_rng(0)
    box = trimesh.creation.box((0.3, 0.02, 0.05))
    hands = [rng.normal(place, 0.03, (40, 3)) for place in ((0, 0, 0.1), (0.2, 0.1, 0), (-0.1, 0, -0.05))]
    stage = Set.of(Mesh(box.vertices, box.faces), hands, config)
    free = []
    for hand in hands:
        points = np.concatenate([box.vertices, hand])
        for back in config.cameras():
            right = np.cross([0, 0, 1], back) / np.linalg.norm(np.cross([0, 0, 1], back))
            seen = (points - stage.centre(hand)) @ np.stack([right, np.cross(back, right), back]).T
            assert (stage.distance - seen[:, 2] > 0).all()
            share = abs(seen[:, :2]).max(1) / (stage.distance - seen[:, 2]) / np.tan(np.radians(20))
            free.append(1 - share.max())
    assert min(free) == pytest.approx(0.2)  # both margins, of half the picture; no farther than it must be


def test_lists_are_balanced_and_random():
    cells = {("a", "x"): list("abcdefg"), ("a", "y"): list("ABC"), ("b", "x"): list("123456")}
    shown = {("a", "x"): 3, ("a", "y"): None, ("b", "x"): 4}
    lists = balanced_lists(cells, shown, 14, np.random.default_rng(0))
    assert all(len(set(trials)) == len(trials) == 3 + 3 + 4 for trials in lists)
    often = Counter(item for trials in lists for item in trials)
    assert [often[i] for i in "abcdefg"] == [6] * 7 and [often[i] for i in "ABC"] == [14] * 3
    assert max(often[i] for i in "123456") - min(often[i] for i in "123456") <= 1
    assert len({tuple(trials) for trials in lists}) == 14


def test_pairs_are_of_one_object_and_two_conditions():
    key = made_key("paired", n=3, shown=None)
    for trials in key.lists:
        for a, b in trials:
            one, two = key.videos[a], key.videos[b]
            assert one.object == two.object and one.condition == "Ground truth" != two.condition
        assert len(trials) == 2 * (3 + 3) and len(key.trials[0]) == 12


def test_a_damaged_key_is_said(tmp_path):
    with pytest.raises(UserError, match="does not exist"):
        StudyKey.read(tmp_path)
    (tmp_path / "private").mkdir()
    for text in ("{", "[]", '{"videos": {}}', '{"videos": {"a": {"x": 1}}}'):
        (tmp_path / "private/key.json").write_text(text)
        with pytest.raises(UserError, match=r"key.json is damaged .*: export the study again"):
            StudyKey.read(tmp_path)
    made_key().write(tmp_path)
    whole = json.loads((tmp_path / "private/key.json").read_text())
    trial = whole["lists"][0][0]
    for changed, reason in [
        ({"lists": []}, "lists are not of trials of 1 videos"), ({"lists": [[]]}, "lists are not of trials"),
        ({"lists": [[trial * 2]]}, "lists are not of trials"), ({"lists": [[["x"]]]}, "lists name other videos"),
        ({"kind": "paired"}, "lists are not of trials of 2"), ({"levels": ["a"]}, "levels are not as many"),
        ({"levels": 5}, "levels"), ({"kind": "other"}, "kind"),
    ]:  # fmt: skip
        (tmp_path / "private/key.json").write_text(json.dumps(whole | changed))
        with pytest.raises(UserError, match=rf"key.json is damaged .*{reason}.*: export the study again"):
            StudyKey.read(tmp_path)


def test_hands_are_measured_from_both_surfaces():
    """A thin plate through a thick hand: no vertex of the hand is deep in the plate."""
    plate = trimesh.creation.box((0.2, 0.2, 0.002))
    ball = trimesh.creation.icosphere(3, 0.02)
    config = CatchConfig(depth=0.01, beyond=0.0, gap=0.02, step=0.005, reach=0.1)
    measured = Catches(Mesh(plate.vertices, plate.faces), config, 0).measure(
        ball.vertices.astype(np.float32), ball.faces
    )
    assert measured.depth == pytest.approx(0.019, abs=1.5e-3) and measured.gap == 0
