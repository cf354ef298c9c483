"""From recordings to a report, by command lines: passes that continue, subsets, data sets side by side."""

from __future__ import annotations

import csv
import json
import re
import shutil
import signal
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from hydra.utils import instantiate

from grabnet.analysis.accumulating import Accumulation, accumulate
from grabnet.analysis.frames import ALL, Frames, Subset
from grabnet.analysis.motion import motion_of
from grabnet.analysis.statistic import Analysed, Row, Statistic
from grabnet.body.hand import HandModel, HandParameters
from grabnet.cli.entry import compose
from grabnet.contact.coloured import PART_COLOURS
from grabnet.data.sequences import read_sequence, write_sequence
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, save_mesh
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.preprocess.statistics import contact_counts
from grabnet.visual.pictures import can_render
from tests.analysis.commands import command, data_of, values
from tests.faults import DiesPublishing
from tests.generation.browser import EXECUTABLE, Browser
from tests.preprocess.tiny_grab import SEQUENCES, grip
from tests.processes import finish

SHOWN = re.compile(r"<(?:script|style|pre)[^>]*>.*?</(?:script|style|pre)>|<[^>]+>", re.DOTALL)


class Toy(Statistic):
    """Frames in which nothing touches: one accumulator, one figure."""

    name, title, about = "toy", "Toy", "Frames in which nothing touches."
    calls = 0

    def add(self, frames: Frames) -> None:
        Toy.calls += 1
        self.count(frames.group, "untouched", (~frames.object.any(1)).sum())

    def result(self, subset: Subset) -> list[Row]:
        return [{"intent": name, "frames": int(self.total("untouched", of))} for name, of in self.by_intent(subset)]

    @classmethod
    def draw(cls, analysed):
        return None


def test_a_statistic_is_a_class_and_a_pass_continues(grab, tmp_path, capsys):
    config = data_of(grab, tmp_path)
    work = Accumulation(config.data, [Toy], config.rules, tmp_path / "counted")
    Toy.calls = 0
    accumulate(work, list(SEQUENCES)[:3], 1, 3)
    statistics, failures, _ = accumulate(work, SEQUENCES, 1, 3)
    assert (Toy.calls, failures) == (len(SEQUENCES), [])
    recordings = [read_sequence(grab[0] / f"grab/{name}.npz") for name in SEQUENCES]
    untouched = {r.name: int((~r.contact.object.any(1)).sum()) for r in recordings}
    rows = Analysed(config.data, statistics).rows(Toy)
    assert rows[0] == {"intent": "all", "frames": sum(untouched.values())}
    Toy.calls = 0
    chosen, _, groups = accumulate(work, SEQUENCES, 1, 3, subset=Subset(subjects=["s2"]))
    expected = sum(n for name, n in untouched.items() if name.startswith("s2"))
    assert (chosen["toy"].result(ALL)[0]["frames"], Toy.calls) == (expected, 0)
    assert {group.subject for group in groups} == {"s1", "s2"}
    accumulate(replace(work, rules=replace(config.rules, seed=1, clusters=3)), SEQUENCES, 1, 3)
    assert Toy.calls == 0  # both are of what is made of what was counted
    with pytest.raises(UserError, match=r"started with rules\.posed_every=3, now it is 1: delete"):
        accumulate(replace(work, rules=replace(config.rules, posed_every=1)), SEQUENCES, 1, 3)


def test_a_recording_that_changed_is_counted_again_and_a_damaged_one_fails(grab, tmp_path, capsys):
    config = data_of(grab, tmp_path)
    (tmp_path / "root/grab/s1").mkdir(parents=True)
    shutil.copytree(grab[0] / "tools", tmp_path / "root/tools")
    for name in SEQUENCES[:2]:
        (tmp_path / f"root/grab/{name}.npz").write_bytes((grab[0] / f"grab/{name}.npz").read_bytes())
    data = replace(config.data, root=str(tmp_path / "root"))
    work = Accumulation(data, [Toy], config.rules, tmp_path / "counted")
    accumulate(work, SEQUENCES[:2], 1, 3)
    (tmp_path / f"root/grab/{SEQUENCES[0]}.npz").write_bytes(b"damaged")
    statistics, (failure,), _ = accumulate(work, SEQUENCES[:2], 1, 3)
    assert f"{SEQUENCES[0]} is counted again" in capsys.readouterr().out
    assert failure.name == SEQUENCES[0] and "not a readable .npz file" in failure.failure
    assert len(statistics["toy"].groups(Subset())) == 1


@pytest.fixture(scope="module")
def report(grab, tmp_path_factory) -> Path:
    """Output of an analysis; not to be written to."""
    output = tmp_path_factory.mktemp("report")
    with pytest.MonkeyPatch.context() as patch:
        assert command(patch, "analyze", values(grab, output)) == 0
    return output


def test_the_report_has_everything(grab, report):
    numbers = json.loads((report / "numbers.json").read_text())["numbers"]
    counts = [contact_counts(read_sequence(grab[0] / f"grab/{name}.npz")) for name in SEQUENCES]
    assert numbers["shares"]["grab"][0]["contact frames"] >= sum(c["frames"] for c in counts)
    assert numbers["content"]["grab"][0]["sequences"] == len(SEQUENCES)
    with (report / "numbers/shares_grab.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [float(line["right hand [%]"]) for line in lines] == [100.0] * len(lines)
    published = {(r["statistic"], r["of"], r["what"]): r for r in numbers["agreement"]}
    assert published["content", "use", "sequences"]["published"] == 579
    assert published["content", "use", "sequences"]["difference"] == numbers["content"]["grab"][3]["sequences"] - 579
    for name in ("content", "shares", "penetration", "thresholds"):
        assert (report / f"figures/{name}.png").read_bytes()[:4] == b"\x89PNG"
        assert (report / f"figures/{name}.pdf").read_bytes()[:4] == b"%PDF"
    page = (report / "report.html").read_text()
    assert "synthetic" not in SHOWN.sub("", page)
    assert not re.search(r'(?:src|href)="(?!data:|#)', page)
    assert len(page) < 3_000_000
    mesh = trimesh.load(report / "meshes/body_grab_all.ply", process=False)
    assert len(mesh.vertices) == 1556
    assert b"property float likelihood" in (report / "meshes/body_grab_all.ply").read_bytes()[:600]


@pytest.mark.parametrize(
    ("more", "missing"),
    [
        (["intents=[offhand]"], ["intent offhand"]),
        (["subjects=[s3]", "objects=[mug]"], ["subject s3"]),
        (["objects=[mug]", "subjects=[s1]"], []),
    ],
)
def test_an_empty_subset_is_said(grab, report, tmp_path, monkeypatch, capsys, more, missing):
    (tmp_path / "counted").symlink_to(report / "counted")
    assert command(monkeypatch, "analyze", values(grab, tmp_path, "scenes=false", *more)) == bool(missing)
    assert "There are no such frames in what was chosen." in SHOWN.sub("", (tmp_path / "report.html").read_text())
    said = [f"error: Nothing that was counted has the chosen {what}." for what in missing]
    assert capsys.readouterr().err.splitlines()[-1:] == said


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("objects=[ball,bal]", "objects names bal: there are apple, ball, mug, table."),
        ("intents=[use,pss]", "intents names pss: there are use, pass, lift, offhand."),
    ],
)
def test_a_misspelt_member_of_a_subset_stops_before_counting(grab, tmp_path, monkeypatch, capsys, more, said):
    with pytest.raises(SystemExit) as end:
        command(monkeypatch, "analyze", values(grab, tmp_path / "out", more))
    assert end.value.code == 2 and said in capsys.readouterr().err
    assert not (tmp_path / "out/counted").exists()


def test_a_recording_without_contact_is_said_and_results_of_before_give_way(grab, tmp_path, monkeypatch):
    root = tmp_path / "root"
    shutil.copytree(grab[0] / "tools", root / "tools")
    for name in ("counted/theirs/recipe.json", "meshes/old.ply", "meshes/mine.txt", "numbers/content_theirs.csv"):
        (tmp_path / "out" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "out" / name).write_text("of before")
    made = read_sequence(grab[0] / f"grab/{SEQUENCES[1]}.npz")
    nothing = replace(made.contact, object=0 * made.contact.object, body=0 * made.contact.body)
    write_sequence(root / f"grab/{SEQUENCES[1]}.npz", replace(made, contact=nothing))
    given = values((root, grab[1]), tmp_path / "out", "data.is_synthetic=true", "scenes=false")
    assert command(monkeypatch, "analyze", given) == 0
    text = SHOWN.sub("", (tmp_path / "out/report.html").read_text())
    assert "“grab” is synthetic: nobody was recorded" in text
    numbers = json.loads((tmp_path / "out/numbers.json").read_text())["numbers"]
    assert numbers["content"]["grab"][0]["contact frames"] == 0
    left = sorted(path.name for place in ("meshes", "numbers") for path in (tmp_path / "out" / place).iterdir())
    assert left[0] == "agreement.csv" and "mine.txt" in left and not {"old.ply", "content_theirs.csv"} & {*left}
    assert numbers["shares"]["grab"][0]["right hand [%]"] is None


def test_meshes_over_time(grab, tmp_path, monkeypatch):
    root, models = grab
    name = SEQUENCES[1]
    given = [
        "data=grab", f"data.root={root}", f"data.models={models}", f"sequence={name}", "every=4",
        "formats=[glb,ply,npz]", f"output={tmp_path}",
    ]  # fmt: skip
    assert command(monkeypatch, "meshes", given) == 0
    made = read_sequence(root / f"grab/{name}.npz")
    number = 8
    frame = np.load(tmp_path / f"frames/{number:05d}.npz")
    solid = trimesh.load(root / "tools/object_meshes/contact_meshes/ball.ply", process=False)
    turn = trimesh.transformations.rotation_matrix(
        np.linalg.norm(made.object.global_orient[number]), made.object.global_orient[number]
    )[:3, :3]
    expected = solid.vertices @ turn + made.object.transl[number]  # acting on row vectors, ref. 1
    np.testing.assert_allclose(frame["object"], expected, atol=1e-5)
    assert (frame["contact_body"] == made.contact.body[number]).all()
    ply = trimesh.load(tmp_path / f"frames/{number:05d}_body.ply", process=False)
    np.testing.assert_allclose(ply.vertices, frame["body"], atol=1e-6)
    assert sorted(p.name for p in (tmp_path / "frames").glob("*.npz")) == ["00000.npz", "00004.npz", "00008.npz"]
    # By the specification of glTF: the frame's mesh in the file, and the times at which it is shown.
    file = (tmp_path / "motion.glb").read_bytes()
    length = struct.unpack_from("<I", file, 12)[0]
    scene, data = json.loads(file[20 : 20 + length]), file[28 + length :]

    def array(accessor: int) -> np.ndarray:
        about = scene["accessors"][accessor]
        kind = {5126: "f4", 5125: "u4", 5121: "u1"}[about["componentType"]]
        start = scene["bufferViews"][about["bufferView"]]["byteOffset"]
        return np.frombuffer(data, kind, about["count"] * {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[about["type"]], start)

    (node,) = [node for node in scene["nodes"] if node["name"] == "object_2"]
    attributes = scene["meshes"][node["mesh"]]["primitives"][0]["attributes"]
    np.testing.assert_allclose(array(attributes["POSITION"]).reshape(-1, 3), expected, atol=1e-5)
    colours = PART_COLOURS[made.contact.object[number]]
    assert (array(attributes["COLOR_0"]).reshape(-1, 4)[:, :3] == colours).all() and len(np.unique(colours)) > 3
    (channel,) = [
        c for c in scene["animations"][0]["channels"] if scene["nodes"][c["target"]["node"]]["name"] == "frame_2"
    ]
    sampler = scene["animations"][0]["samplers"][channel["sampler"]]
    np.testing.assert_allclose(array(sampler["input"]), [0, 8 / made.framerate, 12 / made.framerate])
    assert array(sampler["output"]).tolist() == [0, 0, 0, 1, 1, 1, 1, 1, 1]
    assert len(trimesh.load(tmp_path / "motion.glb", process=False).geometry) == 6  # another reader takes it


def test_meshes_of_no_recording(grab, tmp_path, monkeypatch, capsys):
    root, models = grab
    given = ["data=grab", f"data.root={root}", f"data.models={models}", "sequence=s9/x_lift_1", f"output={tmp_path}"]
    with pytest.raises(SystemExit):
        command(monkeypatch, "meshes", given)
    assert "holds no recording s9/x_lift_1; the first of 7 is s1/apple_lift_1." in capsys.readouterr().err


def test_generated_grasps_are_a_data_set(grab, report, tmp_path, monkeypatch):
    """Two hands in the grip of the recordings, one far from it: shares by hand, on the right hand alone."""
    hand, (centre, radius) = HandModel.open(), grip()
    relaxed = HandParameters(
        torch.eye(3)[None], axis_angle_to_matrix(hand.hands_mean.view(1, 15, 3)), torch.zeros(1, 3)
    )
    vertices = hand(relaxed).vertices[0].numpy() - centre
    for k, shift in enumerate(([0, 0, 0], [0, 0, 0], [0, 0.2, 0])):
        save_mesh(tmp_path / f"grasps/ball/{k}.ply", Mesh(vertices + np.array(shift, np.float32), hand.faces.numpy()))
    shutil.copytree(report / "counted", tmp_path / "out/counted")
    others = ["compare=grasps", f"compare.root={tmp_path / 'grasps'}", "scenes=false"]
    others.append(f"compare.meshes={grab[0] / 'tools/object_meshes/contact_meshes'}")
    assert command(monkeypatch, "analyze", values(grab, tmp_path / "out", *others)) == 0
    numbers = json.loads((tmp_path / "out/numbers.json").read_text())["numbers"]
    (content,) = [row for row in numbers["content"]["grasps"] if row["by"] == "all"]
    assert content == {"by": "all", "name": "all", "sequences": 1, "frames": 3, "contact frames": 2}
    (shares,) = numbers["shares"]["grasps"]
    assert (shares["right hand [%]"], shares["thumb [%]"], shares["index [%]"]) == (100, 100, 100)
    assert (shares["left hand [%]"], shares["palm [%]"]) == (0, 0)
    depths = radius - np.linalg.norm(vertices, axis=1)
    found = {row["of a frame"]: row["mean [mm]"] for row in numbers["penetration"]["grasps"] if row["intent"] == "all"}
    assert found["mean"] == pytest.approx(1000 * depths[depths > 0].mean(), abs=0.1)  # the ball is made of triangles
    assert found["max"] == pytest.approx(1000 * depths.max(), abs=0.1)
    assert numbers["shares"]["difference"][0]["right hand [%]"] == 0
    ours, theirs, change = (numbers["content"][label][0] for label in ("grab", "grasps", "difference"))
    assert change["contact frames"] == ours["contact frames"] - theirs["contact frames"] > 0
    assert (tmp_path / "out/figures/body_heat.png").exists() or can_render()


@pytest.mark.skipif(EXECUTABLE is None, reason="needs Chromium")
def test_a_browser_shows_the_page_and_turns_the_meshes(report, tmp_path):
    with Browser(tmp_path / "profile", (1000, 700)) as browser:
        browser.open(report / "report.html")
        browser.wait("document.getElementById('view').width > 300")
        inked = "(() => { const c = document.getElementById('view'), d = document.createElement('canvas'); "
        inked += "d.width = c.width; d.height = c.height; const x = d.getContext('2d'); x.drawImage(c, 0, 0); "
        inked += "const pixels = x.getImageData(0, 0, d.width, d.height).data; "
        inked += "return pixels.reduce((n, v, i) => n + (i % 4 == 3 && v > 0), 0); })()"
        first = browser.evaluate(inked)
        browser.evaluate("document.getElementById('mesh').selectedIndex = document.getElementById('mesh').length - 1")
        browser.evaluate("document.getElementById('mesh').onchange()")
        second = browser.evaluate(inked)
        assert min(first, second) > 2000 and first != second
        late = "(async () => { const mesh = document.getElementById('mesh'); mesh.selectedIndex = 0; "
        late += "const shown = mesh.onchange(); mesh.selectedIndex = mesh.length - 1; await shown; })()"
        browser.evaluate(late)
        assert browser.evaluate(inked) == second  # what was read too late is not shown
        browser.evaluate("document.getElementById('mesh').value = 'ball'")
        browser.evaluate("document.getElementById('mesh').onchange()")
        names = browser.evaluate("[...document.getElementById('heat').options].map(o => o.value)")
        assert names[:2] == ["grab, all", "grab, use"] and names[-1].startswith("grab, use − ")
        pixels = "(() => { const d = document.createElement('canvas'), c = document.getElementById('view'); "
        pixels += "d.width = c.width; d.height = c.height; const x = d.getContext('2d'); x.drawImage(c, 0, 0); "
        pixels += "return d.toDataURL(); })()"
        likelihood = browser.evaluate(pixels)
        browser.evaluate("document.getElementById('heat').selectedIndex = document.getElementById('heat').length - 1")
        browser.evaluate("document.getElementById('heat').onchange()")
        assert browser.evaluate(pixels) != likelihood
        assert browser.evaluate("document.getElementById('high').textContent").endswith("percentage points")
        assert browser.evaluate("[...document.images].every(image => image.complete && image.naturalWidth > 200)")
        assert browser.log["exceptions"] == [] and browser.log["console"] == []
        assert all(url.startswith(("file:", "data:", "about:")) for url in browser.log["requests"])


def test_a_killed_pass_continues(grab, tmp_path):
    """SIGKILL while the fourth part is written: three are not counted again, and nothing is left of the fourth."""
    given, log = values(grab, tmp_path / "out", "scenes=false", "intents=[]"), tmp_path / "log"
    fault = DiesPublishing(f"{tmp_path}/out/counted/grab/*/*.npz", 4)
    assert finish(given, log, fault, "scripts/analyze.py") == -signal.SIGKILL
    parts = {path: path.stat().st_mtime_ns for path in (tmp_path / "out/counted").rglob("*.npz") if path.name[0] != "."}
    assert finish(given, log, script="scripts/analyze.py") == 0, log.read_text()
    after = sorted((tmp_path / "out/counted").rglob("*"))
    assert len(parts) >= 3 and all(path.stat().st_mtime_ns == time for path, time in parts.items())
    files = [path.relative_to(tmp_path / "out/counted/grab").as_posix() for path in after if path.is_file()]
    assert files == sorted(["recipe.json", *(f"{name}.npz" for name in SEQUENCES)])
    assert "grab has no sequence of intents none. It has intents" in log.read_text()


def test_a_film_keeps_its_camera(grab, tmp_path):
    """Over a recording, the frame is put around the same points, and all of them lie in it."""
    root, models = grab
    given = [
        "data=grab",
        f"data.root={root}",
        f"data.models={models}",
        f"sequence={SEQUENCES[1]}",
        f"output={tmp_path}",
    ]
    config = instantiate(compose("analyze/meshes", given), _convert_="all")
    motion = motion_of(config.data, config.sequence, 1)
    low, high = motion.room.min(0), motion.room.max(0)
    for frame in motion.frames:
        for mesh in (frame.body, frame.object):
            assert (mesh.vertices.min(0) > low - 0.01).all() and (mesh.vertices.max(0) < high + 0.01).all()
