from pathlib import Path

import numpy as np
import pytest
import torch

from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.sdf_grid import AtlasConfig, Level, SDFGrid
from grabnet.io.cache import default_cache
from tests.geometry.shapes import CLOSED_FORMS, box, cup, sphere

SMALL = AtlasConfig(fine_nodes=48**3, coarse_nodes=32**3)
SMALLEST = AtlasConfig(fine_nodes=17**3, coarse_nodes=13**3)


def nodes(level: Level) -> torch.Tensor:
    index = torch.cartesian_prod(*(torch.arange(n) for n in level.values.shape))
    return torch.tensor(level.origin) + level.spacing * index


def node_errors(grid: SDFGrid, exact) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Per level: exact distances at its nodes, and the errors of those stored."""
    found = []
    for level in grid.levels:
        truth = torch.as_tensor(exact(nodes(level)), dtype=torch.float32)
        found.append((truth, level.values.flatten().float() - truth))
    return found


@pytest.mark.parametrize("name", CLOSED_FORMS)
def test_nodes_agree_with_the_closed_form(name):
    build, exact = CLOSED_FORMS[name]
    fine, coarse = node_errors(SDFGrid.build(build(), SMALL), lambda p: exact(p.numpy()))
    truth, error = fine
    assert error[truth.abs() < SMALL.exact_zone].abs().max() < 3e-5  # facets lie up to 25 µm off, float16 2 µm
    assert ((truth * (truth + error)) >= 0)[truth.abs() > 3e-5].all()
    for truth, error in (fine, coarse):
        away = error[truth > SMALL.exact_zone].abs()
        # A trade for time; float16 alone is good to .06 mm at 15 cm and .12 mm beyond 25 cm.
        assert away.mean() < 1e-4
        assert away.quantile(0.99) < 6e-4


def test_an_open_mesh_agrees_with_exact_queries_where_it_has_a_wall():
    mesh = cup()
    fine, _ = node_errors(SDFGrid.build(mesh, SMALL), MeshQuery(mesh).signed_distance)
    truth, error = fine
    # Where the membrane over the opening changes the sign far from any surface, single nodes may be on either side.
    wrong = truth * (truth + error) < 0
    assert wrong.float().mean() < 2e-3
    near = (truth.abs() < SMALL.exact_zone) & ~wrong
    assert error[near].abs().max() < 1e-5
    assert error[~wrong].abs().quantile(0.99) < 3e-4


def test_thin_walls_keep_their_inside():
    plate = box((0.1, 0.08, 0.002))
    level = SDFGrid.build(plate, AtlasConfig()).fine
    assert level.spacing < 0.001
    points, values = nodes(level), level.values.flatten()
    within = (points.abs() < torch.tensor([0.05, 0.04, 0.001])).all(1)
    assert within.sum() > 5000
    assert (values[within] <= 0).all()
    assert (values[~within] >= 0).all()


def test_budgets_and_boxes_are_kept():
    mesh = box((0.3, 0.02, 0.02)).transformed(np.array([[1, 0, 0, 1.0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]))
    grid = SDFGrid.build(mesh, SMALL)
    for level, budget in zip(grid.levels, (SMALL.fine_nodes, SMALL.coarse_nodes), strict=True):
        assert 0.7 * budget < level.values.numel() <= budget
    low, high = nodes(grid.fine).aminmax(dim=0)
    assert (low <= torch.tensor(mesh.bounds[0]) - SMALL.fine_pad + 1e-6).all()
    assert (high >= torch.tensor(mesh.bounds[1]) + SMALL.fine_pad - 1e-6).all()
    low, high = nodes(grid.coarse).aminmax(dim=0)
    assert (low <= torch.tensor(mesh.centroid) - SMALL.coarse_radius + 1e-6).all()
    assert (high >= torch.tensor(mesh.bounds[1]) + SMALL.coarse_pad - 1e-6).all()
    assert grid.fine.spacing < 0.5 * SDFGrid.build(sphere(0.1), SMALL).fine.spacing  # tight along thin axes


def test_the_cache_gives_back_what_was_built(tmp_path, monkeypatch):
    mesh = sphere()
    built = SDFGrid.load_or_build(mesh, tmp_path, SMALL)
    (file,) = tmp_path.iterdir()

    def forbidden(*_):
        raise AssertionError("built although cached")

    with monkeypatch.context() as patch:
        patch.setattr(SDFGrid, "build", forbidden)
        cached = SDFGrid.load_or_build(Mesh(mesh.vertices, mesh.faces), tmp_path, SMALL)
    for a, b in zip(built.levels, cached.levels, strict=True):
        assert (a.origin, a.spacing) == (b.origin, b.spacing)
        assert torch.equal(a.values, b.values)

    SDFGrid.load_or_build(mesh, tmp_path, AtlasConfig(fine_nodes=40**3, coarse_nodes=32**3))
    SDFGrid.load_or_build(sphere(0.05), tmp_path, SMALL)
    assert len(list(tmp_path.iterdir())) == 3
    assert file.exists()


def _changed(content: bytes, damage: str) -> bytes:
    """A cache file with other bytes, most of which make a grid as good as any other."""
    start = content.index(b"\n") + 1
    length = int.from_bytes(content[start : start + 8], "little")
    head, values = content[start : start + 8 + length], content[start + 8 + length :]
    array = np.frombuffer(values, np.float16)
    changed = {
        "truncated": content[:-100],
        "garbage": b"not a tensor in sight",
        "empty": b"",
        "no checksum": content[start:],
        "zeros": content[:start] + head + bytes(len(values)),
        "not a number": content[:start] + head + np.full_like(array, np.nan).tobytes(),
        "other signs": content[:start] + head + (-array).tobytes(),
        "other spacing": content[:start] + head.replace(b", 0.00", b", 0.09", 1) + values,
        "one bit": content[:-1] + bytes([content[-1] ^ 1]),
    }[damage]
    assert changed != content
    return changed


DAMAGES = ["truncated", "garbage", "empty", "no checksum", "zeros"]
DAMAGES += ["not a number", "other signs", "other spacing", "one bit"]


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> tuple[SDFGrid, Path]:
    """The smallest grid and its file."""
    folder = tmp_path_factory.mktemp("grids")
    return SDFGrid.load_or_build(box((0.05, 0.06, 0.08)), folder, SMALLEST), next(folder.iterdir())


@pytest.mark.parametrize("damage", [*DAMAGES, "another's"])
def test_a_damaged_cache_is_rebuilt_with_a_warning(kept, tmp_path, damage):
    (built, file), copy = kept, tmp_path / kept[1].name
    if damage == "another's":
        SDFGrid.load_or_build(box((0.05, 0.06, 0.07)), tmp_path, SMALLEST)
        next(tmp_path.iterdir()).replace(copy)
    else:
        copy.write_bytes(_changed(file.read_bytes(), damage))
    with pytest.warns(UserWarning, match="damaged"):
        again = SDFGrid.load_or_build(box((0.05, 0.06, 0.08)), tmp_path, SMALLEST)
    assert torch.equal(again.fine.values, built.fine.values)
    assert again.fine.spacing == built.fine.spacing


def test_a_cache_that_cannot_be_written_is_only_a_warning(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.warns(UserWarning, match="cannot be written"):
        SDFGrid.load_or_build(sphere(), tmp_path / "file", SMALL)


def test_the_cache_folder_can_be_chosen(tmp_path, monkeypatch):
    monkeypatch.setenv("GRABNET_CACHE", str(tmp_path / "mine"))
    SDFGrid.load_or_build(sphere(), config=SMALL)
    assert len(list((tmp_path / "mine").iterdir())) == 1
    monkeypatch.delenv("GRABNET_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert default_cache() == tmp_path / "xdg" / "grabnet"
