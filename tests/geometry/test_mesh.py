import json

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, load_mesh, save_mesh
from tests.geometry.shapes import box, cup, sphere, torus

FORMATS = ["obj", "ply", "stl", "off", "glb"]
TRIANGLE = b"v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n"


@pytest.mark.parametrize("suffix", FORMATS)
def test_every_format_gives_back_the_same_solid(tmp_path, suffix):
    mesh = torus()
    save_mesh(tmp_path / f"a.{suffix}", mesh)
    back = load_mesh(tmp_path / f"a.{suffix}")
    assert back.faces.shape == mesh.faces.shape
    assert len(back.vertices) == len(mesh.vertices)  # STL's corners are welded again
    np.testing.assert_allclose(back.volume, mesh.volume, rtol=1e-4)
    np.testing.assert_allclose(back.bounds, mesh.bounds, atol=1e-6)
    np.testing.assert_allclose(back.centroid, mesh.centroid, atol=1e-6)


def test_vertex_numbers_survive_in_ply(tmp_path):
    mesh = sphere()
    save_mesh(tmp_path / "a.ply", mesh)
    assert load_mesh(tmp_path / "a.ply").sha256 == load_mesh(tmp_path / "a.ply", weld=False).sha256 == mesh.sha256


def test_without_welding_every_stored_vertex_is_kept(tmp_path):
    (tmp_path / "a.obj").write_bytes(b"v 9 9 9\n" + TRIANGLE.replace(b"1 2 3", b"2 3 4"))
    assert len(load_mesh(tmp_path / "a.obj").vertices) == 3
    assert len(load_mesh(tmp_path / "a.obj", weld=False).vertices) == 4


def test_scenes_are_flattened_with_their_transforms(tmp_path):
    scene = trimesh.Scene()
    for x in (-0.1, 0.1):
        scene.add_geometry(
            trimesh.creation.box((0.02,) * 3), transform=trimesh.transformations.translation_matrix([x, 0, 0])
        )
    for name, data in scene.export(file_type="gltf").items():
        (tmp_path / name).write_bytes(data)
    mesh = load_mesh(tmp_path / "model.gltf")
    np.testing.assert_allclose(mesh.bounds, [[-0.11, -0.01, -0.01], [0.11, 0.01, 0.01]], atol=1e-7)
    np.testing.assert_allclose(mesh.volume, 2 * 0.02**3, rtol=1e-5)


def gltf(uri: str) -> bytes:
    return json.dumps({"asset": {"version": "2.0"}, "buffers": [{"uri": uri, "byteLength": 3}]}).encode()


def stl(name: str) -> bytes:
    return trimesh.creation.box((0.1, 0.1, 0.1)).export(file_type=name)


@pytest.mark.parametrize(
    ("name", "data", "sentence"),
    [
        ("a.xyz", b"1 2 3", r"extension \.xyz; meshes are read from \.obj"),
        ("a.obj", b"", "is empty"),
        ("a.ply", b"ply\nformat ascii 1.0\nend_header\n", "is empty: it holds no vertices"),
        ("a.ply", stl("stl"), r"looks like \.stl, rename it"),
        ("a.stl", stl("ply"), r"looks like \.ply, rename it"),
        ("a.obj", stl("glb"), r"looks like \.glb, rename it"),
        ("a.obj", b"hello\nworld\n", "no line starts with v: give it its true extension"),
        ("a.stl", stl("stl")[:-7], "ends before its 12 triangles"),
        ("a.ply", stl("ply")[:-7], "not a readable .ply file .it ends before its 12 of face"),
        ("a.glb", stl("glb")[:-90], "it ends within a chunk"),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n", "not a readable .off file"),
        ("a.obj", TRIANGLE.replace(b"0.1 0 0", b"nan 0 0"), "1 vertices that are NaN or infinite"),
        ("a.obj", TRIANGLE.replace(b"0.1 0 0", b"1e39 0 0"), "1 vertices that are NaN or infinite"),
        ("a.obj", TRIANGLE.split(b"f")[0], "3 vertices but no faces"),
        ("a.obj", TRIANGLE.replace(b"0.1 0 0", b"0 0.2 0"), "has zero area"),
        ("a.obj", TRIANGLE.replace(b"1 2 3", b"1 1 1"), "has zero area"),
        ("a.gltf", b"{}", "is empty"),
        ("a.gltf", gltf("../secret.bin"), "outside its own folder"),
        ("a.gltf", gltf("/etc/hostname"), "outside its own folder"),
        ("a.gltf", gltf("%2e%2e/secret.bin"), "outside its own folder"),
        ("a.gltf", gltf("gone.bin"), "does not exist"),
        ("a.gltf", gltf("http://localhost/x.bin"), "addresses are not read"),
    ],
)
def test_bad_files_are_refused_in_one_sentence(tmp_path, name, data, sentence):
    (tmp_path / "secret.bin").write_bytes(b"abc")
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / name).write_bytes(data)
    with pytest.raises(UserError, match=sentence) as error:
        load_mesh(folder / name)
    assert name in str(error.value)
    assert "\n" not in str(error.value)


def test_missing_files_and_folders_are_refused(tmp_path):
    with pytest.raises(UserError, match="does not exist"):
        load_mesh(tmp_path / "gone.obj")
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(UserError, match="cannot be read"):
        load_mesh(tmp_path / "folder.obj")


def test_too_many_faces_are_refused(tmp_path):
    n = 2_000_001
    records = np.zeros(n, dtype=np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]))
    records["corners"][:] = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    (tmp_path / "a.stl").write_bytes(bytes(80) + np.uint32(n).tobytes() + records.tobytes())
    with pytest.raises(UserError, match="has 2,000,001 faces; simplify"):
        load_mesh(tmp_path / "a.stl")


def test_equal_geometry_has_an_equal_hash_and_no_other():
    assert sphere().sha256 == sphere().sha256
    assert len({sphere().sha256, sphere(0.05).sha256, torus().sha256}) == 3


def test_meshes_cannot_change_under_their_hash():
    with pytest.raises(ValueError, match="read-only"):
        sphere().vertices[0] = 0


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 2**31), n=st.integers(1, 3000))
def test_samples_lie_on_the_surface_with_its_normals(seed, n):
    points, normals = box((0.2, 0.1, 0.05)).sample_surface(n, seed)
    assert points.shape == normals.shape == (n, 3)
    axis = np.abs(normals).argmax(1)
    rows = np.arange(n)
    np.testing.assert_allclose(np.abs(normals)[rows, axis], 1, atol=1e-6)
    np.testing.assert_allclose((points * normals).sum(1), np.array([0.1, 0.05, 0.025])[axis], atol=1e-7)


def test_samples_are_even_by_area():
    sides = np.array([0.2, 0.1, 0.05])
    _, normals = box(tuple(sides)).sample_surface(60_000, 1)
    area = np.prod(sides) / sides
    np.testing.assert_allclose(np.abs(normals).mean(0), area / area.sum(), atol=0.01)


def test_volume_tells_inside_out():
    mesh = box((0.2, 0.1, 0.05))
    np.testing.assert_allclose(mesh.volume, 0.001, rtol=1e-5)
    np.testing.assert_allclose(Mesh(mesh.vertices + 5, mesh.faces[:, ::-1]).volume, -0.001, rtol=1e-3)


def test_closed_means_every_edge_has_two_sides():
    mesh = box((0.2, 0.1, 0.05))
    assert mesh.is_closed
    assert torus().is_closed
    assert not Mesh(mesh.vertices, mesh.faces[1:]).is_closed
    assert not cup().is_closed
    turned = mesh.faces.copy()
    turned[0] = turned[0][::-1]
    assert not Mesh(mesh.vertices, turned).is_closed
    assert not Mesh(mesh.vertices, np.concatenate([mesh.faces, mesh.faces])).is_closed
