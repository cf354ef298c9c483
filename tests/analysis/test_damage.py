"""Recordings and folders that are damaged, mixed or of another kind; markers in all forms."""

from __future__ import annotations

import io
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hydra.utils import instantiate
from PIL import Image

from grabnet.analysis.accumulating import Accumulation, accumulate
from grabnet.analysis.markers import read_markers
from grabnet.analysis.registry import STATISTICS
from grabnet.analysis.statistic import Analysed
from grabnet.analysis.statistics.clusters import Clusters
from grabnet.analysis.statistics.content import Content
from grabnet.analysis.statistics.shares import ContactShares
from grabnet.body.skeleton import MIRRORED_PART
from grabnet.cli.entry import compose
from grabnet.data.objects import object_files
from grabnet.data.sequences import read_sequence, write_sequence
from grabnet.errors import UserError
from grabnet.mosh.layouts import read_object_layouts
from grabnet.visual.pictures import can_render
from tests.analysis.commands import command, data_of, values
from tests.preprocess.tiny_grab import SEQUENCES


class TestHostile:
    """Recordings, folders and markers that are damaged, mixed or of another kind."""

    @pytest.fixture
    def mixed(self, grab, tmp_path) -> Path:
        """A root with one good recording, and more to be put beside it."""
        shutil.copytree(grab[0] / "tools", tmp_path / "root/tools")
        (tmp_path / "root/grab/s1").mkdir(parents=True)
        shutil.copy(grab[0] / f"grab/{SEQUENCES[1]}.npz", tmp_path / f"root/grab/{SEQUENCES[1]}.npz")
        return tmp_path / "root"

    def counted(self, grab, root: Path, kinds=STATISTICS):
        config = data_of(grab, root)
        work = Accumulation(replace(config.data, root=str(root)), kinds, config.rules, root.parent / "counted")
        statistics, failures, _ = accumulate(work, work.data.names(), 1, 3)
        return Analysed(work.data, statistics), [outcome.failure for outcome in failures]

    def test_recordings_that_cannot_be_counted_are_named_and_the_others_counted(self, grab, mixed, capsys):
        made = read_sequence(mixed / f"grab/{SEQUENCES[1]}.npz")
        other_body = replace(made.contact, body=np.zeros((len(made), 99), np.uint8))
        write_sequence(mixed / "grab/s1/ball_lift_2.npz", replace(made, contact=other_body))
        arrays = dict(np.load(mixed / f"grab/{SEQUENCES[1]}.npz", allow_pickle=True))
        for k, missing in ((3, "contact"), (4, "table")):
            np.savez(mixed / f"grab/s1/ball_lift_{k}.npz", **{n: a for n, a in arrays.items() if n != missing})
        (mixed / "grab/s1/ball_lift_\x1b[31m5.npz").write_bytes(b"no archive")
        analysed, failures = self.counted(grab, mixed)
        assert len(failures) == 4 and "\x1b" not in "".join(failures) + capsys.readouterr().out
        said = "labels 99 vertices of a body, the subjects' meshes have 1556"
        assert sum(said in sentence for sentence in failures) == 1
        assert sum("contact" in sentence or "table" in sentence for sentence in failures) == 2
        assert analysed.rows(Content)[0]["sequences"] == 1

    def test_a_recording_of_the_left_hand_alone(self, grab, mixed):
        made = read_sequence(mixed / f"grab/{SEQUENCES[1]}.npz")
        mirrored = replace(made.contact, object=MIRRORED_PART[made.contact.object])
        write_sequence(mixed / f"grab/{SEQUENCES[1]}.npz", replace(made, contact=mirrored))
        analysed, failures = self.counted(grab, mixed)
        (shares, _) = analysed.rows(ContactShares)
        assert (failures, shares["left hand [%]"], shares["right hand [%]"]) == ([], 100, 0)
        assert np.isnan(shares["thumb [%]"]) and analysed.rows(Clusters) == []
        for kind in STATISTICS:
            kind.draw([analysed])

    def test_names_are_text_in_the_page(self, grab, mixed, tmp_path, monkeypatch):
        made, meshes = read_sequence(mixed / f"grab/{SEQUENCES[1]}.npz"), mixed / "tools/object_meshes/contact_meshes"
        bad = "<img src=x onerror=alert(1)>$x$"
        shutil.copy(meshes / "ball.ply", meshes / f"{bad}.ply")
        write_sequence(mixed / f"grab/{SEQUENCES[1]}.npz", replace(made, obj_name=bad))
        given = values((mixed, grab[1]), tmp_path / "out", "data.label='<b>$y$'")
        assert command(monkeypatch, "analyze", given) == 0
        page = (tmp_path / "out/report.html").read_text()
        assert "<img src=x" not in page and "<b>$y" not in page and "&lt;img src=x onerror" in page

    def test_a_damaged_part_is_counted_again(self, grab, mixed, capsys):
        self.counted(grab, mixed, [Content])
        part = mixed.parent / f"counted/{SEQUENCES[1]}.npz"
        part.write_bytes(part.read_bytes()[:100])
        analysed, failures = self.counted(grab, mixed, [Content])
        assert "is counted again" in capsys.readouterr().out
        assert (failures, analysed.rows(Content)[0]["sequences"]) == ([], 1)

    def test_bodies_that_depths_follow_from_are_inputs(self, grab, mixed, tmp_path, capsys):
        """With stored labels, too: a template that changes is counted again, another body model is refused."""
        self.counted(grab, mixed, [Content])
        vtemp = mixed / read_sequence(mixed / f"grab/{SEQUENCES[1]}.npz").body.vtemp
        solid = trimesh.load(vtemp, process=False)
        vtemp.write_bytes(trimesh.Trimesh(1.01 * solid.vertices, solid.faces, process=False).export(file_type="ply"))
        assert self.counted(grab, mixed, [Content])[1] == []
        assert f"{vtemp} has changed" in capsys.readouterr().out
        data = replace(data_of(grab, tmp_path).data, root=str(mixed))
        assert {"SMPLX_FEMALE.npz", "SMPLX_MALE.npz"} < data.recipe()["models"].keys()
        _ = data.surface  # of the template as it was
        vtemp.write_bytes(trimesh.Trimesh(solid.vertices[:99], [[0, 1, 2]], process=False).export(file_type="ply"))
        with pytest.raises(UserError, match=r"\.ply has 99 vertices, the body 1556"):
            data.frames(SEQUENCES[1])

    def test_results_of_others_stay(self, grab, tmp_path, monkeypatch, capsys):
        (tmp_path / "figures").mkdir()
        (tmp_path / "figures/mine.png").write_bytes(b"mine")
        with pytest.raises(SystemExit):
            command(monkeypatch, "analyze", values(grab, tmp_path))
        assert "mine.png is not of earlier results" in capsys.readouterr().err
        assert (tmp_path / "figures/mine.png").read_bytes() == b"mine"


class TestMarkers:
    """Positions, numbers of vertices, and a layout of MoSh's."""

    def test_all_forms_are_read(self, grab, tmp_path):
        objects = object_files(grab[0] / "tools/object_meshes/contact_meshes")
        vertices = trimesh.load(objects["ball"], process=False).vertices
        np.save(tmp_path / "ball.npy", np.array([5, 7]))
        np.save(tmp_path / "mug.npy", vertices[:3])
        found = read_markers(str(tmp_path), objects, "data.markers")
        np.testing.assert_allclose(found["ball"], vertices[[5, 7]], atol=1e-6)
        np.testing.assert_allclose(found["mug"], vertices[:3])
        lines = [f"  m{k}: [{', '.join(f'{x:.5f}' for x in vertices[k])}]" for k in (0, 100, 200)]
        (tmp_path / "layout.yaml").write_text("\n".join(["ball:", *lines]))
        np.testing.assert_allclose(
            read_markers(f"{tmp_path}/layout.yaml", objects, "data.markers")["ball"][1], vertices[100], atol=1e-5
        )

    @pytest.mark.parametrize(
        ("array", "said"),
        [
            (np.zeros((3, 2)), "holds no markers"),
            (np.array([[0, 0, np.nan]]), "holds no markers"),
            (np.array([10**6]), "names a vertex that"),
            (1000 * np.eye(3), "metres in the object's frame are needed"),
        ],
    )
    def test_others_are_refused(self, grab, tmp_path, array, said):
        np.save(tmp_path / "ball.npy", array)
        with pytest.raises(UserError, match=said):
            read_markers(str(tmp_path), object_files(grab[0] / "tools/object_meshes/contact_meshes"), "data.markers")

    @pytest.mark.parametrize("field", ["data.markers", "compare.markers"])
    def test_markers_of_other_objects_are_refused_by_the_name_of_their_field(
        self, grab, tmp_path, monkeypatch, capsys, field
    ):
        np.save(tmp_path / "other.npy", np.zeros((3, 3)))
        more = ["compare=open", f"compare.root={grab[0]}", f"compare.models={grab[1]}", "compare.markers=null"]
        with pytest.raises(SystemExit):
            command(monkeypatch, "analyze", values(grab, tmp_path / "out", *more, f"{field}={tmp_path}"))
        assert f"give {field} another path, or {field}=null." in capsys.readouterr().err

    def test_the_open_layout_is_of_the_open_objects(self):
        """What the open data's config names: markers on the surfaces of the open objects."""
        markers = instantiate(compose("analyze/analyze", []), _convert_="all").data.markers
        assert len(read_object_layouts(markers)) > 50

    @pytest.mark.skipif(bool(can_render()), reason="draws no pictures here")
    def test_clusters_show_their_markers_in_red(self, grab, mixed_markers):
        figures = [Clusters.draw([analysed]) for analysed in mixed_markers]
        red = []
        for figure in figures:
            figure.savefig(buffer := io.BytesIO(), dpi=130)
            pixels = np.asarray(Image.open(buffer).convert("RGB")).astype(int)
            red.append(int(((pixels[..., 0] > 120) & (pixels[..., 1:].max(-1) < 80)).sum()))
        assert red[0] == 0 and red[1] > 20
        assert mixed_markers[0].rows(Clusters)[0]["clusters touching markers"] is None
        touching = mixed_markers[1].rows(Clusters)[0]
        assert touching["clusters touching markers"] == touching["clusters"] > 0

    @pytest.fixture
    def mixed_markers(self, grab, tmp_path) -> list[Analysed]:
        """The same grasps of a ball without markers, and with one at each of its vertices."""
        config, found = data_of(grab, tmp_path), []
        vertices = trimesh.load(grab[0] / "tools/object_meshes/contact_meshes/ball.ply", process=False).vertices
        for markers in ({}, {"ball": vertices[::25]}):
            work = Accumulation(config.data, [Clusters], config.rules, tmp_path / "counted")
            statistics, _, _ = accumulate(work, SEQUENCES[1:2], 1, 3)
            statistics["clusters"].markers = markers
            found.append(Analysed(config.data, statistics))
        return found
