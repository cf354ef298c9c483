import numpy as np
import pytest
import torch
import trimesh

from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, load_mesh
from grabnet.geometry.object_mesh import check_size, file_to_object, load_object
from tests.geometry.shapes import box


@pytest.mark.parametrize(
    ("side", "remedy"),
    [
        (95.0, r"larger than 40 cm when read as metres: pass scale=0\.001 .* or max_size=95 if it is so\."),
        (9.5, r"scale=0\.01 if it is in centimetres or scale=0\.0254 if it is in inches"),
        (0.0001, r"smaller than 1 cm .* scale=<metres per unit"),
    ],
)
def test_sizes_no_hand_takes_are_refused_with_a_scale(side, remedy):
    with pytest.raises(UserError, match=remedy):
        check_size(box((side, side / 2, side / 3)), "mug.obj")


def test_sizes_a_hand_takes_pass():
    check_size(box((0.011, 0.001, 0.001)), "pin")
    check_size(box((0.39, 0.1, 0.1)), "pan")
    check_size(box((0.7, 0.1, 0.1)), "broom", largest=0.71)


@pytest.mark.parametrize(
    ("name", "up", "expected"),
    [("a.obj", None, "z"), ("a.GLB", None, "y"), ("a.gltf", None, "y"), ("a.glb", "z", "z"), ("a.ply", "x", "x")],
)
def test_the_up_axis_becomes_z_in_metres(name, up, expected):
    matrix = file_to_object(name, 0.001, up)
    np.testing.assert_allclose(matrix[:3, :3] @ np.eye(3)["xyz".index(expected)], [0, 0, 0.001], atol=1e-12)
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, 1e-6 * np.eye(3), atol=1e-15)
    assert np.linalg.det(matrix) > 0  # a mirror image would make left hands of right ones


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), float("inf")])
def test_a_scale_must_be_a_positive_number(scale):
    with pytest.raises(UserError, match="positive number of metres per unit"):
        file_to_object("a.obj", scale)


def test_an_axis_that_is_none_is_refused():
    with pytest.raises(UserError, match="up is 'w'; it can be x, y or z"):
        file_to_object("a.obj", up="w")


def test_a_file_and_its_mesh_are_the_same_object(tmp_path):
    path = tmp_path / "bar.glb"
    trimesh.creation.box((20, 70, 30)).export(path)
    from_file = load_object(path, scale=0.001)
    from_mesh = load_object(load_mesh(path), scale=0.001, up="y")
    np.testing.assert_array_equal(from_file.to_object, from_mesh.to_object)
    np.testing.assert_allclose(from_file.solid.extents, [0.02, 0.03, 0.07], atol=1e-6)
    np.testing.assert_allclose(from_file.mesh.extents, [20, 70, 30], atol=1e-4)


def test_a_mesh_in_millimetres_is_refused_like_its_file(tmp_path):
    path = tmp_path / "cup_mm.obj"
    trimesh.creation.box((60, 70, 90)).export(path)
    for given in (path, load_mesh(path)):
        with pytest.raises(UserError, match=r"largest side of 90, larger than 40 cm .* pass scale=0\.001"):
            load_object(given)


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([-1.0, 1, 1, 1]),  # a reflection
        np.diag([1.0, 1, 2, 1]),  # axes of different scales
        np.array([[1.0, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]),  # a shear
        np.zeros((4, 4)),
        np.diag([1.0, 1, np.nan, 1]),
        np.eye(3),
        np.diag([1.0, 1, 1, 2]),
        np.diag([-1.0, -1, -1, 1]),  # a point reflection
        np.diag([1.0, 1, 1e-9, 1]),  # a projection, nearly
        np.diag([1.0, 1, 1.001, 1]),
        np.diag([1.0, 1, np.inf, 1]),
        np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0.1, 0, 0, 1]]),  # the shift in the last row
        np.array([[1.0, 0, 0, np.nan], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]),
        np.eye(4)[None],
        np.eye(4)[:3],
        np.eye(4) * 1j,
        np.eye(4).astype(str),
        np.eye(4, dtype=bool),
        [[1, 0], [0]],
        "z",
        {},
        torch.eye(4, requires_grad=True),
    ],
)
def test_what_is_no_similarity_is_refused(matrix):
    with pytest.raises(UserError, match="to_object is no rotation times a scale"):
        load_object(box((0.1, 0.05, 0.02)), to_object=matrix)


@pytest.mark.parametrize("scale", [1.0, 1e-3, 0.0254])
def test_a_rotation_times_a_scale_with_a_shift_is_taken(scale):
    matrix = np.eye(4)
    matrix[:3, :3] = scale * trimesh.transformations.random_rotation_matrix(np.array([0.1, 0.5, 0.9]))[:3, :3]
    matrix[:3, 3] = 0.3, -0.2, 0.1
    for given in (matrix, matrix.tolist(), matrix.astype(np.float32), torch.tensor(matrix)):
        loaded = load_object(box(np.array((0.1, 0.05, 0.02)) / scale), to_object=given)
        np.testing.assert_allclose(loaded.to_object, matrix, rtol=1e-6)
        centre = loaded.mesh.vertices.mean(0) @ matrix[:3, :3].T + matrix[:3, 3]
        np.testing.assert_allclose(loaded.solid.vertices.mean(0), centre, atol=1e-6)


@pytest.mark.parametrize("offset", [(150, 0, 0), (0, 0, -1e5), (1e9, 1e9, 1e9), (1e5, 3e4, 0)])
def test_a_mesh_far_from_its_origin_is_refused(tmp_path, offset):
    """Along one axis, too; as a file, as a mesh, and where to_object carries it away."""
    solid = trimesh.creation.box((0.06, 0.05, 0.1))
    corners = solid.vertices + np.array(offset)
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in corners] + [f"f {a} {b} {c}" for a, b, c in solid.faces + 1]
    (tmp_path / "far.obj").write_text("\n".join(lines))
    away = np.eye(4)
    away[:3, 3] = offset
    for given, matrix in ((tmp_path / "far.obj", None), (box((0.06, 0.05, 0.1)), away)):
        with pytest.raises(UserError, match=r"times its size; more than 1,000 times .*: move it to the origin"):
            load_object(given, to_object=matrix)
    near = Mesh(solid.vertices + 50, solid.faces)  # 866 times its size
    assert load_object(near).solid.volume == pytest.approx(3e-4, rel=1e-3)


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 1, 1), (1, -2, 3)])
@pytest.mark.parametrize(("gap", "said"), [(0.04, None), (0.25, "25 cm"), (1000, "1,000 m")])
def test_parts_far_apart_are_said(direction, gap, said):
    way = np.array(direction) / np.linalg.norm(direction)
    one, other = (trimesh.creation.icosphere(3, 0.02).apply_translation(s * (gap / 2 + 0.02) * way) for s in (-1, 1))
    parts = trimesh.util.concatenate([one, other])
    remarks = load_object(Mesh(parts.vertices, parts.faces), max_size=2000).remarks
    assert len(remarks) == (said is not None)
    assert said is None or remarks[0].startswith(f"parts of it lie {said} apart")


def test_a_mesh_is_mended_like_its_file():
    solid = box((0.06, 0.05, 0.1))
    twice = Mesh(solid.vertices, np.concatenate([solid.faces, solid.faces[:, ::-1]]))
    placed = load_object(twice)
    assert placed.remarks == ("dropped 12 of 24 faces, which were there twice",)
    assert placed.solid.volume == pytest.approx(3e-4, rel=1e-5)
