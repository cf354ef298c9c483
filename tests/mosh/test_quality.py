"""What a report says of a recording, how far workers have come, and the meshes of objects."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from grabnet.errors import UserError
from grabnet.mosh.layouts import object_layout
from grabnet.mosh.markers import MarkerData
from grabnet.mosh.objects import Following, check_objects, follow_one, mesh_of
from grabnet.mosh.quality import Limits, flagged, quality
from grabnet.mosh.tallies import Tally, followed

HOW = Following(0.004, 12, 0.0)
CORNERS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])


def test_a_fast_hand_has_not_jumped_where_its_marker_is_as_fast():
    model = np.zeros((5, 2, 3))
    model[3:, 0, 0] = 0.5  # half a metre in a frame, at 50 frames a second
    observed = model.copy()
    limits = Limits()
    residuals = np.linalg.norm(model - observed, axis=-1)
    assert not len(flagged(residuals, model, observed, 50, limits)["jump"])
    assert flagged(residuals, model, np.zeros_like(model), 50, limits)["jump"].tolist() == [3]
    observed[2, 0] = np.nan  # unseen before
    assert flagged(residuals, model, observed, 50, limits)["jump"].tolist() == [3]
    assert not len(flagged(residuals, model, observed, 5, limits)["jump"]), "the rate counts"


def test_what_is_missing_or_not_believed_stands_beside_the_distances(actor):
    layout = replace(actor.layout, markers=actor.layout.markers[:4])
    model, observed = np.zeros((10, 4, 3)), np.zeros((10, 4, 3))
    observed[:, 1] = np.nan
    observed[:5, 2, 0] = 0.1
    facts = quality(np.linalg.norm(model - observed, axis=-1), model, observed, 50, layout, Limits())
    assert facts["missing"] == 0.25 and facts["outliers"] == 0.125 and facts["flagged_frames"] == 5
    own = facts["residual_mm_by_marker"]
    assert own[layout.labels[1]] == {"mean": None, "median": None, "p95": None, "missing": 1.0, "outliers": 0.0}
    assert own[layout.labels[2]]["outliers"] == 0.5 and facts["residual_mm"]["median"] == 0


class Counted(SimpleNamespace):
    """Counts as `grabnet.cli.progress.Steps` does."""

    def advance(self, n: float, about: str) -> None:
        self.done, self.about = self.done + n, about


def test_frames_of_workers_add_up(tmp_path):
    counted = Counted(done=0.0, about="")
    (tmp_path / "mosh").mkdir()
    (tmp_path / "mosh/b.tally").write_text("99")  # of a run that was killed
    with followed(tmp_path, {"a": 100, "b": 50}, counted) as ended:
        Tally(tmp_path, "a").add(30)
        deadline = time.monotonic() + 20
        while counted.done < 30 and time.monotonic() < deadline:
            time.sleep(0.05)
        assert counted.done == 30 and "0 of 2 captures" in counted.about
        ended("a")
        assert counted.done == 100 and "1 of 2 captures" in counted.about
        ended("b")  # it failed at once: nothing of it is left to do
    assert counted.done == 150 and not [*(tmp_path / "mosh").iterdir()]


def capture(labels: str, places: np.ndarray = CORNERS) -> MarkerData:
    positions = places + np.linspace(0, 0.2, 6)[:, None, None] * [0, 0, 1.0]
    return MarkerData(tuple(f"box:{label}" for label in labels), positions, 50.0)


def test_an_object_that_is_only_a_list_of_positions(tmp_path):
    box = object_layout("box", ["a", "b", "c", "d"], CORNERS)
    found = follow_one(capture("abcd"), {"box": box}, HOW)
    np.testing.assert_allclose(found.motion.transl[:, 2], np.linspace(0, 0.2, 6), atol=1e-9)
    assert found.quality()["residual_mm"] == 0 and not found.notes
    mesh = mesh_of(tmp_path, box)
    assert np.abs(mesh.vertices.reshape(4, -1, 3).mean(1) - CORNERS).max() < 1e-6, "a ball at each marker"
    assert (tmp_path / "tools/object_meshes/contact_meshes/box.ply").exists()


def test_the_object_that_moves_is_followed_and_not_the_one_that_is_hidden():
    """Of a large tray that lies still two markers are missing by turns, so that the middle of the others jumps."""
    box = capture("abcd")
    tray = np.tile(10 * CORNERS, (6, 1, 1))
    tray[::2, :2] = tray[1::2, 2:] = np.nan
    labels = box.labels + tuple(f"tray:{label}" for label in "abcd")
    both = MarkerData(labels, np.concatenate([box.positions, tray], 1), box.rate)
    layouts = {
        name: object_layout(name, ["a", "b", "c", "d"], size * CORNERS) for name, size in (("box", 1), ("tray", 10))
    }
    assert follow_one(both, layouts, HOW).name == "box"


def test_labels_of_objects_that_do_not_fit_are_named():
    box = object_layout("box", ["a", "b", "c", "d"], CORNERS)
    found = follow_one(capture("abcz"), {"box": box}, HOW)
    assert found.notes == ("The layout of box has no place for z: not used.", "box has no d.")
    with pytest.raises(
        UserError, match="box has 2 markers of its layout, and 3 are needed; the capture has a, b, y, z"
    ):
        follow_one(capture("abyz"), {"box": box}, HOW)
    assert (
        "No object of the layout is among the prefixes box" in follow_one(capture("abcd"), {"mug": box}, HOW).notes[0]
    )


def test_objects_that_cannot_be_written_are_refused(tmp_path):
    box = object_layout("../box", ["a", "b", "c", "d"], CORNERS)
    with pytest.raises(UserError, match=r"An object is named '\.\./box'"):
        check_objects(None, {"../box": box})
    with pytest.raises(UserError, match="meshes= is given without objects="):
        check_objects(str(tmp_path), {})
    with pytest.raises(UserError, match="holds a mesh of none of the objects that have a layout: box"):
        check_objects(str(tmp_path), {"box": box})
