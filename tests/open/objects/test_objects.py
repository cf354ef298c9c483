"""Every open object as written to disk: closed, even, standing, of everyday size; and the writing itself."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from grabnet.data.objects import OBJECT_MESHES
from grabnet.errors import UserError
from grabnet.geometry.mesh import load_mesh
from grabnet.io.files import sha256
from grabnet.open.objects import OBJECTS, build_object, grasp_regions, prop, writing
from grabnet.open.objects.writing import write_objects

# Longest and shortest side of the bounding box, cm: ranges of everyday things and toys.
SIZES = {
    "airplane": ((15, 22), (5, 9)),
    "alarmclock": ((10, 16), (4, 7)),
    "apple": ((7, 9), (6.5, 8.5)),
    "banana": ((16, 21), (3, 4.5)),
    "binoculars": ((11, 16), (4.5, 7)),
    "bowl": ((12, 18), (5, 8)),
    "camera": ((11, 15), (6, 10)),
    "cubelarge": ((7.9, 8.1), (7.9, 8.1)),
    "cubemedium": ((5.9, 6.1), (5.9, 6.1)),
    "cubesmall": ((3.9, 4.1), (3.9, 4.1)),
    "cup": ((8, 12), (6.5, 9)),
    "cylinderlarge": ((11, 13), (6, 8)),
    "cylindermedium": ((8, 10), (5, 6)),
    "cylindersmall": ((5, 7), (3, 4)),
    "doorknob": ((5.5, 8), (5, 7)),
    "duck": ((8, 13), (6, 9)),
    "elephant": ((13, 19), (7, 10)),
    "eyeglasses": ((13, 16), (3.5, 5.5)),
    "flashlight": ((13, 20), (3.5, 5.5)),
    "flute": ((28, 36), (2, 3)),
    "fryingpan": ((35, 40), (4, 9)),
    "gamecontroller": ((14, 17), (4, 7)),
    "hammer": ((26, 33), (2, 3.5)),
    "hand": ((16, 21), (4, 7)),
    "headphones": ((16, 21), (5, 9)),
    "knife": ((20, 26), (1.2, 2.5)),
    "lightbulb": ((10, 12), (5.5, 6.5)),
    "mouse": ((10, 15), (3, 4.5)),
    "mug": ((10, 13), (7.5, 9.5)),
    "phone": ((13, 16.5), (0.7, 1.1)),
    "piggybank": ((11, 16), (7, 10)),
    "pyramidlarge": ((8, 9), (8, 9)),
    "pyramidmedium": ((6, 7), (6, 7)),
    "pyramidsmall": ((4, 5), (4, 5)),
    "scissors": ((15, 21), (1, 2)),
    "spherelarge": ((7.9, 8.1), (7.9, 8.1)),
    "spheremedium": ((5.9, 6.1), (5.9, 6.1)),
    "spheresmall": ((3.9, 4.1), (3.9, 4.1)),
    "stamp": ((7, 10), (2.5, 4.5)),
    "stanfordbunny": ((12, 17), (7, 11)),
    "stapler": ((11, 16), (3, 4.5)),
    "table": ((10, 16), (6, 10)),
    "teapot": ((16, 23), (10, 14)),
    "toothbrush": ((17, 20), (1, 2)),
    "toothpaste": ((13, 19), (3, 4.5)),
    "toruslarge": ((11, 13), (2.8, 3.6)),
    "torusmedium": ((8, 10), (2, 2.8)),
    "torussmall": ((5, 7), (1.2, 2)),
    "train": ((11, 16), (5, 8)),
    "watch": ((5.5, 8), (3.5, 5.5)),
    "waterbottle": ((18, 24), (6, 8)),
    "wineglass": ((17, 22), (6.5, 9)),
}
THREE_SIZES = ("cube", "cylinder", "pyramid", "sphere", "torus")
# Closed surfaces with handles and holes: how many.
HOLES = {
    "apple": 0, "bowl": 0, "cup": 0, "wineglass": 0, "waterbottle": 0, "lightbulb": 0, "mug": 1, "teapot": 1,
    "fryingpan": 1, "toruslarge": 1, "watch": 1, "scissors": 2,
}  # fmt: skip


@pytest.fixture(scope="session")
def root(pytestconfig: pytest.Config) -> Path:
    """The objects as the command writes them; pytest's cache keeps them until their source changes."""
    source = sha256(*sorted(Path(writing.__file__).parent.glob("*.py")))
    folder = Path(pytestconfig.cache.mkdir(f"open_objects_{source[:8]}"))
    write_objects(folder)
    return folder


@pytest.fixture(scope="session")
def meshes(root: Path) -> dict[str, trimesh.Trimesh]:
    return {name: load_mesh(root / OBJECT_MESHES / f"{name}.ply").trimesh() for name in OBJECTS}


def test_the_objects_are_those_of_grab():
    assert list(OBJECTS) == sorted(SIZES)
    assert len(OBJECTS) == 52


@pytest.mark.parametrize("name", OBJECTS)
def test_closed_outward_in_one_piece(meshes, name):
    mesh = meshes[name]
    directed = np.concatenate([mesh.faces[:, [i, (i + 1) % 3]] for i in range(3)]).astype(np.int64)
    key, reverse = directed @ [1 << 32, 1], directed @ [1, 1 << 32]
    assert len(np.unique(key)) == len(key)
    np.testing.assert_array_equal(np.sort(key), np.sort(reverse))
    assert mesh.volume > 0
    assert mesh.body_count == 1
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)


@pytest.mark.parametrize("name", OBJECTS)
def test_evenly_meshed(meshes, name):
    mesh, edge = meshes[name], prop(name).edge
    lengths = mesh.edges_unique_length / edge
    assert len(mesh.faces) <= 40_000
    assert 0.84 < np.median(lengths) < 1.06
    assert np.percentile(lengths, 5) > 0.65
    assert np.percentile(lengths, 95) < 1.45
    assert lengths.max() < 1.7
    smallest = np.degrees(mesh.face_angles.min(1))
    assert smallest.min() > 12
    assert np.percentile(smallest, 1) > 25


@pytest.mark.parametrize("name", OBJECTS)
def test_mesh_lies_on_the_solid(meshes, name):
    points, _ = trimesh.sample.sample_surface(meshes[name], 3000, seed=0)
    off = np.abs(prop(name).solid.distance(np.asarray(points)))
    # Off by more only across sharp edges, cut short by up to half a triangle.
    assert np.percentile(off, 95) < 0.0003
    assert off.max() < 0.0013


@pytest.mark.parametrize("name", OBJECTS)
def test_everyday_size(meshes, name):
    sides = 100 * meshes[name].extents
    longest, shortest = SIZES[name]
    assert longest[0] <= sides.max() <= longest[1]
    assert shortest[0] <= sides.min() <= shortest[1]


@pytest.mark.parametrize("kind", THREE_SIZES)
def test_three_sizes_are_far_apart(meshes, kind):
    small, medium, large = (meshes[kind + size].volume for size in ("small", "medium", "large"))
    assert small * 2 < medium < large / 2


@pytest.mark.parametrize("name", sorted(set(OBJECTS) - {"scissors"}))  # whose bows alone touch the table
def test_rests_on_the_table_without_tipping(meshes, name):
    mesh = meshes[name]
    assert abs(mesh.vertices[:, 2].min()) < 0.0005
    low = mesh.vertices[mesh.vertices[:, 2] < mesh.vertices[:, 2].min() + 0.0008, :2]
    support = ConvexHull(low)
    assert (support.equations[:, :2] @ mesh.center_mass[:2] + support.equations[:, 2]).max() < 0


@pytest.mark.parametrize("name", ["bowl", "cup", "fryingpan", "mug", "wineglass"])
def test_vessels_are_hollow(meshes, name):
    assert meshes[name].volume < 0.45 * meshes[name].convex_hull.volume


@pytest.mark.parametrize("name", HOLES)
def test_handles_are_open(meshes, name):
    assert meshes[name].euler_number == 2 - 2 * HOLES[name]


@pytest.mark.parametrize("name", OBJECTS)
def test_grasp_regions_hold_surface(meshes, name):
    regions = grasp_regions(name)
    assert sum(region.weight for region in regions) <= 1 + 1e-9
    for region in regions:
        inside = ((meshes[name].vertices > region.low) & (meshes[name].vertices < region.high)).all(1)
        assert inside.sum() >= 50, region.name
        assert region.weight > 0


@pytest.mark.parametrize(
    ("name", "part"),
    [("mug", "handle"), ("fryingpan", "handle"), ("hammer", "handle"), ("wineglass", "stem"), ("teapot", "handle")],
)
def test_handles_are_apart_from_the_rest(meshes, name, part):
    """The named part is slim: no wider than a hand closes around."""
    region = next(region for region in grasp_regions(name) if region.name == part)
    inside = ((meshes[name].vertices > region.low) & (meshes[name].vertices < region.high)).all(1)
    sides = np.sort(np.ptp(meshes[name].vertices[inside], axis=0))
    assert sides[0] < 0.035
    assert inside.mean() < 0.6


@pytest.mark.parametrize("name", ["cubesmall", "knife", "stamp"])
def test_another_process_built_the_same_mesh(root, name):
    assert build_object(name).sha256 == load_mesh(root / OBJECT_MESHES / f"{name}.ply").sha256


def test_unknown_name_lists_the_known():
    with pytest.raises(UserError, match=r"'teacup'.*teapot"):
        build_object("teacup")


def test_only_what_is_damaged_is_written_again(root):
    damaged, kept = root / OBJECT_MESHES / "spheresmall.ply", root / OBJECT_MESHES / "mug.ply"
    whole, before = damaged.read_bytes(), kept.stat().st_mtime_ns
    damaged.write_bytes(whole[:1000])
    paths = write_objects(root, processes=1)
    assert damaged.read_bytes() == whole
    assert kept.stat().st_mtime_ns == before
    assert [path.stem for path in paths] == list(OBJECTS)


def test_another_format_is_meshed_again(tmp_path, monkeypatch):
    monkeypatch.setattr(writing, "OBJECTS", dict.fromkeys(("cubesmall", "spheresmall")))
    meshes = write_objects(tmp_path, processes=1)
    before = [path.stat().st_mtime_ns for path in meshes]
    assert [path.stat().st_mtime_ns for path in write_objects(tmp_path, processes=1)] == before
    monkeypatch.setattr(writing, "FORMAT", writing.FORMAT + 1)
    after = [path.stat().st_mtime_ns for path in write_objects(tmp_path, processes=1)]
    assert all(new > old for new, old in zip(after, before, strict=True))


def test_bad_arguments_are_told_in_a_sentence(tmp_path):
    (tmp_path / "file").touch()
    script = Path(__file__).parents[3] / "scripts" / "build_open.py"
    command = [sys.executable, str(script), "objects", "--root", str(tmp_path / "file")]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert ended.stderr.count("\n") == 1
    assert "choose another root" in ended.stderr
