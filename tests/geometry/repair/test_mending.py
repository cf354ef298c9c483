"""Meshes whose faces disagree get back the inside that they had; sound ones stay as they are, number by number."""

import numpy as np
import pytest
import torch
import trimesh

from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, with_sides
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.repair.mending import mended
from tests.geometry.shapes import cup


def of(solid: trimesh.Trimesh, shift=(0, 0, 0)) -> Mesh:
    return Mesh(solid.vertices + np.array(shift), solid.faces)


def block(*sides: float, shift=(0, 0, 0)) -> Mesh:
    return of(trimesh.creation.box(sides).subdivide(), shift)


def turned(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


def joined(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    faces = [m.faces + start for m, start in zip(meshes, starts, strict=True)]
    return Mesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces))


def tube() -> Mesh:
    """Open at both ends."""
    solid = trimesh.creation.cylinder(0.008, 0.06, sections=24)
    return Mesh(solid.vertices + np.array([0, 0, 0.05]), solid.faces[np.abs(solid.face_normals[:, 2]) < 0.5])


def half_ball(radius: float) -> Mesh:
    ball = trimesh.creation.icosphere(3)
    return Mesh(ball.vertices * radius, ball.faces[ball.triangles_center[:, 2] < 0])


def unwelded(mesh: Mesh) -> Mesh:
    """Every face with corners of its own, a little beside those of its neighbours."""
    corners = mesh.triangles.reshape(-1, 3)
    noise = np.random.default_rng(0).normal(0, 1e-6, corners.shape)
    return Mesh(corners + noise, np.arange(len(corners)).reshape(-1, 3))


def in_sides(mesh: Mesh) -> Mesh:
    """Every flat side a part of its own, a little smaller."""
    solid = mesh.trimesh()
    parts = []
    for side in solid.facets:
        middle = solid.triangles_center[side].mean(0)
        parts.append(Mesh((mesh.vertices - middle) * 0.9999 + middle, mesh.faces[side]))
    return joined(*parts)


BALL = of(trimesh.creation.icosphere(3, 0.04))
SOUND = {
    "ball": BALL,
    "ring": of(trimesh.creation.torus(0.04, 0.012)),
    "cup": cup(),
    "hollow": joined(block(0.06, 0.05, 0.1), turned(block(0.04, 0.03, 0.08))),
    "apart": joined(block(0.03, 0.03, 0.03, shift=(0.05, 0, 0)), block(0.04, 0.05, 0.06)),
    "overlapping": joined(block(0.03, 0.03, 0.03, shift=(0.02, 0, 0)), block(0.04, 0.05, 0.06)),
    "touching": joined(block(0.04, 0.04, 0.04), block(0.04, 0.04, 0.04, shift=(0.04, 0.04, 0))),
    "with a tube": joined(BALL, tube()),
    "bowl": joined(half_ball(0.05), turned(half_ball(0.047))),
    "unwelded": unwelded(of(trimesh.creation.icosphere(2, 0.04))),
    "in sides": in_sides(of(trimesh.creation.box((0.06, 0.05, 0.1)))),
}
WITHIN = joined(block(0.06, 0.05, 0.1), block(0.04, 0.03, 0.08))  # a part wholly inside another


def inside(mesh: Mesh, points: torch.Tensor) -> np.ndarray:
    return (MeshQuery(mesh).signed_distance(points) < 0).numpy()


def assert_same_inside(mesh: Mesh, sound: Mesh) -> None:
    low, high = sound.bounds
    points = torch.from_numpy(np.random.default_rng(1).uniform(low - 0.01, high + 0.01, (3000, 3)).astype(np.float32))
    points = points[MeshQuery(sound).closest(points).distance > 1e-4]
    np.testing.assert_array_equal(inside(mesh, points), inside(sound, points))


@pytest.mark.parametrize("name", SOUND)
def test_sound_meshes_stay_as_they_are(name):
    assert with_sides(SOUND[name], name) is SOUND[name]


def test_a_part_within_another_stays_solid():
    assert with_sides(WITHIN, "it") is WITHIN


@pytest.mark.parametrize("name", SOUND)
@pytest.mark.parametrize("fault", ["flipped", "inside out", "double", "partly double"])
def test_what_was_broken_has_its_inside_again(name, fault):
    sound, rng = SOUND[name], np.random.default_rng(0)
    faces = sound.faces.copy()
    some, others = rng.random((2, len(faces))) < 0.5
    if fault in ("flipped", "partly double"):
        faces[some] = faces[some, ::-1]
    if fault == "inside out":
        faces = faces[:, ::-1]
    if fault == "double":
        faces = rng.permutation(np.concatenate([faces, faces[:, [1, 0, 2]]]))
    if fault == "partly double":
        faces = np.concatenate([faces, faces[others][:, [1, 0, 2]], faces[others & some]])
    mesh = with_sides(Mesh(sound.vertices, faces), name)
    assert len(mesh.faces) == len(sound.faces)
    assert mesh.repairs
    assert_same_inside(mesh, sound)


def two_layers(corners: np.ndarray, quads: np.ndarray) -> tuple[Mesh, np.ndarray]:
    """A surface of quads (Q, 4), and the faces of its back, which cut the quads along their other diagonals."""
    front, back = (quads[:, order].reshape(-1, 3) for order in ([0, 1, 2, 0, 2, 3], [0, 3, 1, 1, 3, 2]))
    return Mesh(corners, front), back


def cells(corners: np.ndarray, closed: bool) -> tuple[Mesh, np.ndarray]:
    """Likewise over a grid of corners (N, M, 3), closed along the first axis and, if so said, the second."""
    number = np.arange(corners[..., 0].size).reshape(corners.shape[:2])
    a, d = (number if closed else number[:, :-1], np.roll(number, -1, 1) if closed else number[:, 1:])
    b, c = np.roll(a, -1, 0), np.roll(d, -1, 0)
    return two_layers(corners.reshape(-1, 3), np.stack([a, b, c, d], -1).reshape(-1, 4))


def twisted_ring() -> tuple[Mesh, np.ndarray]:
    """No cell is flat."""
    i, j = np.meshgrid(np.arange(32), np.arange(12), indexing="ij")
    around, across = 2 * np.pi * i / 32 + 0.1 * np.minimum(j, 12 - j), 2 * np.pi * j / 12
    radius = 0.04 + 0.012 * np.cos(across)
    corners = np.stack([radius * np.cos(around), radius * np.sin(around), 0.012 * np.sin(across)], -1)
    return cells(corners, closed=True)


def open_bowl() -> tuple[Mesh, np.ndarray]:
    """A zone of a ball, open above and below."""
    around, down = np.meshgrid(2 * np.pi * np.arange(24) / 24, np.linspace(2.9, np.pi / 2, 8), indexing="ij")
    corners = np.stack([np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)], -1)
    return cells(0.04 * corners, closed=False)


def box_cells() -> tuple[Mesh, np.ndarray]:
    """300 cm³."""
    corners = np.array([[x, y, z] for x in (0, 0.05) for y in (0, 0.06) for z in (0, 0.1)])
    return two_layers(corners, np.array(
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    ))  # fmt: skip


@pytest.mark.parametrize("make", [box_cells, twisted_ring, open_bowl])
@pytest.mark.parametrize("fault", ["back", "again", "partly", "flipped", "back first"])
def test_a_second_layer_of_other_diagonals_is_dropped(make, fault):
    sound, back = make()
    rng = np.random.default_rng(0)
    faces = np.concatenate([sound.faces, back])
    if fault == "again":
        faces = np.concatenate([sound.faces, back[:, ::-1]])
    if fault == "partly":
        faces = np.concatenate([sound.faces, back.reshape(-1, 2, 3)[:3].reshape(-1, 3)])
    if fault == "flipped":
        faces = rng.permutation(np.where(rng.random((len(faces), 1)) < 0.5, faces, faces[:, ::-1]))
    if fault == "back first":
        faces = np.concatenate([back, sound.faces])
    mesh = with_sides(Mesh(sound.vertices, faces), "it")
    assert len(mesh.faces) == len(sound.faces) and mesh.is_closed == sound.is_closed
    assert (
        mesh.repairs[0] == f"dropped {len(faces) - len(sound.faces):,} of {len(faces):,} faces, which were there twice"
    )
    # Where cells are not flat it is either way of cutting them, or some of each.
    assert mesh.volume == pytest.approx(sound.volume, rel=0.02 if make is twisted_ring else 1e-6)


@pytest.mark.parametrize("first", ["fine", "coarse"])
def test_a_second_layer_of_finer_faces_is_dropped(first):
    box, _ = box_cells()
    fine = box.subdivided()
    two = (fine, turned(box)) if first == "fine" else (box, turned(fine))
    beside = tuple(Mesh(mesh.vertices + np.float32(0.25), mesh.faces) for mesh in two)
    assert with_sides(joined(*two), "it").volume == pytest.approx(3e-4, rel=1e-6)
    assert with_sides(joined(*two, *beside), "it").volume == pytest.approx(6e-4, rel=1e-5)


def test_parts_that_share_a_wall_stay():
    """However it is cut, and beside an open part."""
    box, back = box_cells()
    other = Mesh(box.vertices + np.float32([0.05, 0, 0]), box.faces)
    otherwise = Mesh(other.vertices, back[:, ::-1])
    for parts in ((box, other), (box, otherwise), (box, otherwise, tube())):
        mesh = joined(*parts)
        assert with_sides(mesh, "it") is mesh


def test_a_part_inside_out_beside_a_sound_one():
    one, other = block(0.03, 0.03, 0.03, shift=(0.05, 0, 0)), block(0.04, 0.05, 0.06)
    mesh = with_sides(joined(turned(one), other), "it")
    assert mesh.repairs == ("turned 48 of 96 faces, which looked the wrong way",)
    assert_same_inside(mesh, joined(one, other))


def test_fins_and_sheets_of_two_sides_stay():
    """They are a surface to touch, and enclose nothing."""
    solid = block(0.04, 0.05, 0.06)
    corner = int(solid.vertices.sum(1).argmax())
    neighbour = int(solid.faces[(solid.faces == corner).any(1)][0][0])
    other = next(v for v in solid.faces[(solid.faces == corner).any(1)].ravel() if v not in (corner, neighbour))
    tip = Mesh(np.concatenate([solid.vertices, solid.vertices[corner][None] * 1.5]), solid.faces)
    fin = np.array([[corner, other, len(solid.vertices)], [corner, len(solid.vertices), other]])
    with_fin = Mesh(tip.vertices, np.concatenate([tip.faces, fin]))
    assert with_sides(with_fin, "it") is with_fin
    sheet = Mesh([[0.1, 0, 0], [0.1, 0.05, 0], [0.1, 0, 0.05]], [[0, 1, 2], [0, 2, 1]])
    with_sheet = joined(solid, sheet)
    assert with_sides(with_sheet, "it") is with_sheet
    assert_same_inside(with_sheet, solid)


def test_vertices_and_numbers_stay_where_faces_are_not_welded():
    corners = BALL.triangles.reshape(-1, 3)
    faces = np.arange(len(corners)).reshape(-1, 3)
    flip = np.random.default_rng(0).random(len(faces)) < 0.5
    found = mended(corners, np.where(flip[:, None], faces[:, ::-1], faces)).faces
    np.testing.assert_array_equal(found, faces)


def test_lines_and_points_among_faces_are_passed_over():
    faces = np.concatenate([BALL.faces[:100], [[0, 0, 1], [5, 5, 5]], BALL.faces[100:, ::-1]])
    found, repairs = mended(BALL.vertices, faces)
    assert found[100:102].tolist() == [[0, 0, 1], [5, 5, 5]]
    assert len(repairs) == 1 and Mesh(BALL.vertices, found).volume == pytest.approx(BALL.volume, rel=1e-6)


def test_faces_without_area_are_not_asked():
    line = np.array([[0, 0, 0], [0.01, 0, 0], [0.02, 0, 0], [0.03, 0, 0]])
    faces = np.array([[0, 1, 2], [1, 3, 2], [0, 1, 3]])
    assert len(mended(line, faces).faces) == 3


def test_a_strip_with_a_twist_is_refused():
    n = 60
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    across = 0.02 * np.stack(
        [np.cos(angle / 2) * np.cos(angle), np.cos(angle / 2) * np.sin(angle), np.sin(angle / 2)], 1
    )
    middle = 0.05 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    a, b = np.arange(n), np.arange(n) + n
    c, d = np.roll(a, -1), np.roll(b, -1)
    c[-1], d[-1] = n, 0  # joined with a twist
    strip = Mesh(
        np.concatenate([middle + across, middle - across]),
        np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)]),
    )
    with pytest.raises(
        UserError, match=r"strip\.obj does not tell which side of its faces is inside: make a solid of it"
    ):
        with_sides(strip, "strip.obj")
