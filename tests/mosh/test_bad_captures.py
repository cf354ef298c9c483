"""Captures that cannot be solved: each ends the command in one sentence that names the file and what is wrong."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from hydra.utils import instantiate

from grabnet.cli.entry import compose
from grabnet.errors import UserError
from grabnet.mosh.c3d import write_c3d
from grabnet.mosh.run import run
from tests.mosh.conftest import Actor

FAST = ("stage_one.iterations=1", "stage_one.annealing=[1.0]", "stage_one.frames=2", "stage_two.sweeps=1",
        "workers=1", "pictures=false", "quiet=true")  # fmt: skip


def solve(path: Path, out: Path, *values: str) -> int:
    return run(instantiate(compose("mosh/mosh", [f"capture={path}", f"out={out}", *FAST, *values]), _convert_="all"))


def c3d(path: Path, actor: Actor, frames: int = 4, change: Callable | None = None, **options) -> Path:
    """A capture of the actor; `change` alters the file's content before it is written again."""
    labels = [f"s1:{label}" for label in actor.layout.labels]
    write_c3d(path, labels, options.pop("places", actor.markers[:frames]), 24, **options)
    if change is not None:
        file = ezc3d.c3d(str(path))
        change(file)
        file.write(str(path))
    return path


def unit(name: str) -> Callable:
    def change(file) -> None:
        file["parameters"]["POINT"]["UNITS"]["value"] = [name]

    return change


def label(old: str, new: str) -> Callable:
    def change(file) -> None:
        labels = file["parameters"]["POINT"]["LABELS"]["value"]
        labels[labels.index(f"s1:{old}")] = f"s1:{new}"

    return change


def twice_as_prefix(file) -> None:
    labels = file["parameters"]["POINT"]["LABELS"]["value"]
    file["parameters"]["POINT"]["LABELS"]["value"] = [
        name.replace("s1:", "anna:" if i % 2 else "ben:") for i, name in enumerate(labels)
    ]


def cut(share: float) -> Callable:
    def make(path: Path, actor: Actor) -> None:
        data = c3d(path, actor).read_bytes()
        path.write_bytes(data[: int(share * len(data))])

    return make


def analog_only(path: Path, actor: Actor) -> None:
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100]
    file["parameters"]["ANALOG"]["RATE"]["value"] = [1000]
    file["parameters"]["ANALOG"]["LABELS"]["value"] = ["Force.Fx1"]
    file["data"]["analogs"], file["data"]["points"] = np.zeros((1, 1, 50)), np.zeros((4, 0, 5))
    file.write(str(path))


def no_frames(path: Path, actor: Actor) -> None:
    whole = c3d(path, actor).read_bytes()
    start = 512 * (int.from_bytes(whole[16:18], "little") - 1)
    path.write_bytes(whole[:6] + bytes([1, 0, 0, 0]) + whole[10:start])


def with_places(change: Callable[[np.ndarray], None], frames: int = 4) -> Callable:
    def make(path: Path, actor: Actor) -> None:
        places = actor.markers[:frames].copy()
        change(places)
        c3d(path, actor, places=places)

    return make


def hide(*which) -> Callable:
    def change(places: np.ndarray) -> None:
        places[which] = np.nan

    return change


REFUSED = {
    "cut off in its frames": (cut(0.7), r"is cut off: it has [\d,]+ bytes of the [\d,]+"),
    "cut off in its header": (cut(0.02), "is no c3d file"),
    "cut off in its parameters": (cut(0.1), "holds no frames: it ends where they should start"),
    "empty": (lambda path, _: path.write_bytes(b""), "is no c3d file"),
    "millimetres as metres": (lambda p, a: c3d(p, a, change=unit("m")), "which no capture does: give"),
    "metres as millimetres": (lambda p, a: c3d(p, a, unit="m", change=unit("mm")), "which no capture does"),
    "millimetres as centimetres": (lambda p, a: c3d(p, a, change=unit("cm")), "10 times as far apart as on a body"),
    "centimetres as millimetres": (lambda p, a: c3d(p, a, places=a.markers[:4] / 10), "0.1 times as far apart"),
    "degrees": (lambda p, a: c3d(p, a, change=unit("deg")), "in the unit 'deg', which is no length"),
    "a label that is nearly right": (lambda p, a: c3d(p, a, change=label("LKNE", "LKNEE")), "its nearest is 'LKNE'"),
    "labels in another case": (lambda p, a: c3d(p, a, change=label("LKNE", "lkne")), "its nearest is 'LKNE'"),
    "two subjects": (lambda p, a: c3d(p, a, change=twice_as_prefix), "say whom to solve by reading.prefix="),
    "no frame with any marker": (with_places(hide(slice(None))), "are missing in all 4 frames"),
    "never half of the body": (with_places(hide(slice(None), slice(30, None))), "no frame shows enough of the subject"),
    "no trunk": (
        with_places(lambda places: hide(slice(None), slice(0, 30))(places)), "no frame shows enough of the subject",
    ),
    "0 frames": (no_frames, "holds no frames: it ends where they should start"),
    "analog data only": (analog_only, "analog data only"),
    "not c3d": (lambda path, _: path.write_bytes(b"PK\x03\x04" * 300), "is no c3d file"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_what_cannot_be_solved_is_refused_in_one_sentence(kind, actor, tmp_path):
    make, sentence = REFUSED[kind]
    path = tmp_path / "x_lift_1.c3d"
    make(path, actor)
    with pytest.raises(UserError, match=sentence) as refused:
        solve(path, tmp_path / "out")
    said = str(refused.value)
    assert str(path) in said and "\n" not in said and re.search(r"[.]$", said) and not said.endswith("..")
    assert not (tmp_path / "out/grab").exists()


@pytest.mark.parametrize(
    "change", [hide(1), hide(2, slice(5, 20)), lambda places: np.put(places, 7, np.inf)], ids=["frame", "some", "inf"]
)
def test_frames_without_markers_are_solved_through(change, actor, tmp_path):
    with_places(change)(tmp_path / "x_lift_1.c3d", actor)
    assert solve(tmp_path / "x_lift_1.c3d", tmp_path / "out") == 0


def test_a_later_capture_in_another_unit_fails_alone(actor, tmp_path, capsys):
    """Stage I has seen the first only."""
    (tmp_path / "captures").mkdir()
    c3d(tmp_path / "captures/a_lift_1.c3d", actor)
    c3d(tmp_path / "captures/b_lift_1.c3d", actor, change=unit("cm"))
    assert solve(tmp_path / "captures", tmp_path / "out", "stage_one_captures=1") == 1
    said = capsys.readouterr().err
    assert "error: s1/b_lift_1: " in said and "9.9 times as far apart as on a body" in said
    assert (tmp_path / "out/grab/s1/a_lift_1.npz").exists() and not (tmp_path / "out/grab/s1/b_lift_1.npz").exists()
