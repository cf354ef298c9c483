import json

import numpy as np
import pytest
import smplx
import torch
import trimesh
from PIL import Image

from grabnet.body.hand import OPEN_HANDS, HandModel, HandParameters
from grabnet.errors import UserError
from grabnet.generation.export import result_folders, write_grasps
from grabnet.generation.formats import FORMATS
from grabnet.generation.grasps import RECORD, Grasps, has_results, record_of
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.object_mesh import load_object
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.io.files import filling
from grabnet.io.npz import read_npz
from grabnet.visual.pictures import can_render

# Millimetres, y up.
TO_OBJECT = np.array([[0.001, 0, 0, 0], [0, 0, -0.001, 0], [0, 0.001, 0, 0], [0, 0, 0, 1]])
# From z up to glTF's y up.
Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


@pytest.fixture(scope="module", params=["right", "left"])
def grasps(request, grabber, cache_dir) -> Grasps:
    box = trimesh.creation.box((50, 60, 70)).subdivide().subdivide()
    mesh = Mesh(box.vertices + np.array([300, -200, 100]), box.faces)
    return grabber(mesh, 3, 5, request.param, to_object=TO_OBJECT, cache_dir=cache_dir)


@pytest.fixture(scope="module")
def folder(grasps, tmp_path_factory):
    folder = tmp_path_factory.mktemp("out") / "deep" / "a bäll"
    write_grasps(folder, grasps, {"name": "a bäll", "mesh": "/x"}, list(FORMATS), sheet=0)
    return folder


def test_parameters_pose_the_hand_in_smplx(folder, grasps):
    """The field's own loader, given the numbers in the file, finds the vertices that were exported."""
    saved = read_npz(folder / "grasps.npz")
    assert saved["side"] == grasps.side
    model = smplx.create(
        str(OPEN_HANDS / f"MANO_{grasps.side.upper()}.npz"),
        "mano",
        ext="npz",
        is_rhand=grasps.side == "right",
        use_pca=False,
        flat_hand_mean=True,
        batch_size=3,
    )
    pose = {k: torch.tensor(saved[k]) for k in ("global_orient", "hand_pose", "transl", "betas")}
    vertices = model(**pose).vertices.detach() * float(saved["units_per_metre"])
    torch.testing.assert_close(vertices, grasps.vertices, atol=0.01, rtol=0)  # millimetres


def test_parameters_pose_the_hand_model(folder, grasps):
    saved = read_npz(folder / "grasps.npz")
    hand = HandModel.open(grasps.side)
    parameters = HandParameters(
        axis_angle_to_matrix(torch.tensor(saved["global_orient"])),
        axis_angle_to_matrix(torch.tensor(saved["hand_pose"]).unflatten(1, (15, 3))),
        torch.tensor(saved["transl"]),
    )
    vertices = hand(parameters, hand.shaped(torch.tensor(saved["betas"]))).vertices * float(saved["units_per_metre"])
    torch.testing.assert_close(vertices, grasps.vertices, atol=0.005, rtol=0)


def test_every_format_holds_the_same_meshes(folder, grasps):
    arrays = read_npz(folder / "meshes" / "meshes.npz")
    np.testing.assert_array_equal(arrays["hand_vertices"], grasps.vertices)
    np.testing.assert_array_equal(arrays["object_faces"], grasps.mesh.faces)
    solid = trimesh.load(folder / "meshes" / "object.ply", process=False)
    np.testing.assert_array_equal(solid.vertices.astype(np.float32), grasps.mesh.vertices)
    for i in range(3):
        ply = trimesh.load(folder / "meshes" / f"hand_{i:03d}.ply", process=False)
        scene = trimesh.load(folder / "meshes" / f"grasp_{i:03d}.glb", process=False)
        assert set(scene.graph.nodes_geometry) == {"object", "hand"}
        for name in scene.graph.nodes_geometry:
            np.testing.assert_allclose(scene.graph[name][0], Y_UP @ TO_OBJECT, atol=1e-12)
        for hand in (ply, scene.geometry["hand"]):
            np.testing.assert_array_equal(hand.vertices.astype(np.float32), grasps.vertices[i])
            np.testing.assert_array_equal(hand.faces, grasps.faces)
        np.testing.assert_array_equal(scene.geometry["object"].vertices.astype(np.float32), grasps.mesh.vertices)


@pytest.mark.parametrize(("scale", "up"), [(1.0, "z"), (0.001, "z"), (0.01, "y"), (0.001, "x")])
def test_glb_is_read_back_at_the_same_place(tmp_path, scale, up):
    """In metres and y up, as every viewer takes it; the numbers of its vertices are the mesh's own."""
    solid = trimesh.creation.box((0.06, 0.05, 0.1))
    mesh = Mesh(solid.vertices / scale + np.array([0.3, 0.2, 0.1]) / scale, solid.faces)
    placed = load_object(mesh, scale, up)
    hand = np.random.default_rng(0).random((1, 5, 3)).astype(np.float32) / scale
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2]])
    FORMATS["glb"](tmp_path, placed, hand, faces)
    both = np.concatenate([mesh.vertices, hand[0]]) @ placed.to_object[:3, :3].T + placed.to_object[:3, 3]
    back = load_object(tmp_path / "grasp_000.glb", max_size=2)
    np.testing.assert_allclose(np.sort(back.solid.vertices, 0), np.sort(both, 0), atol=1e-6)
    shown = trimesh.load_scene(tmp_path / "grasp_000.glb")
    np.testing.assert_allclose(
        shown.bounds, [(both @ Y_UP[:3, :3].T).min(0), (both @ Y_UP[:3, :3].T).max(0)], atol=1e-6
    )


def test_json_holds_record_and_grasps(folder, grasps):
    text = json.loads((folder / "grasps.json").read_text(encoding="utf-8"))
    assert text["grasps"] == grasps.report()
    assert text["name"] == "a bäll"
    assert text["remarks"] == []


def test_a_second_call_replaces_results_and_nothing_else(grasps, tmp_path):
    folder = tmp_path / "out"
    write_grasps(folder, grasps, {"name": "a"}, ["ply"], sheet=0)
    (folder / "notes.txt").write_text("mine")
    write_grasps(folder, grasps.first(1), {"name": "a"}, ["npz"], sheet=0, page=0)
    assert sorted(p.name for p in folder.iterdir()) == ["grasps.json", "grasps.npz", "meshes", "notes.txt"]
    assert [p.name for p in (folder / "meshes").iterdir()] == ["meshes.npz"]
    assert len(read_npz(folder / "grasps.npz")["transl"]) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out"]


def test_a_call_that_fails_leaves_what_was_there(grasps, tmp_path):
    folder = tmp_path / "out"
    write_grasps(folder, grasps, {"name": "a"}, [], sheet=0)
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    with pytest.raises(TypeError):
        write_grasps(folder, grasps, {"name": "a", "bad": object()}, [], sheet=0)
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before
    with pytest.raises(TypeError):
        write_grasps(tmp_path / "new", grasps, {"name": "a", "bad": object()}, [], sheet=0)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out"]


@pytest.mark.skipif(can_render() is not None, reason=str(can_render()))
def test_contact_sheet_shows_hands_and_object(grasps, tmp_path):
    write_grasps(tmp_path / "out", grasps, {"name": "a"}, [], sheet=2)
    image = np.asarray(Image.open(tmp_path / "out" / "contact_sheet.png").convert("RGB")).astype(int)
    warm, cool = image[..., 0] - image[..., 2] > 30, image[..., 2] - image[..., 0] > 15
    for half in np.array_split(np.arange(image.shape[1]), 2):
        assert warm[:, half].any() and cool[:, half].any()


def test_folders_are_named_after_meshes_and_never_shared(tmp_path):
    a, b, c = (tmp_path / d / "cup.obj" for d in "abc")
    for mesh in (a, b, c):
        mesh.parent.mkdir()
        mesh.touch()
    out = tmp_path / "out"
    assert result_folders([a, b], out) == {a: out / "cup", b: out / "cup-2"}
    assert result_folders([a, tmp_path / "Cup.ply"], out)[tmp_path / "Cup.ply"] == out / "Cup-2"
    for mesh, folder in result_folders([a, b], out).items():
        folder.mkdir(parents=True)
        (folder / "grasps.json").write_text(json.dumps({"mesh": str(mesh.resolve())}))
    # Later calls, in any order: each mesh finds its own folder again, a third one gets a new one.
    assert result_folders([c, b], out) == {c: out / "cup-3", b: out / "cup-2"}
    (out / "bowl").mkdir()
    (out / "bowl" / "photo.jpg").touch()
    assert result_folders([tmp_path / "bowl.ply"], out) == {tmp_path / "bowl.ply": out / "bowl-2"}


@pytest.mark.parametrize("name", ["...obj", "....ply", ". .stl", "..glb"])
def test_no_name_of_a_mesh_leads_out_of_the_output(name, tmp_path):
    out = tmp_path / "out"
    for mesh, folder in result_folders([tmp_path / name, tmp_path / "other" / name], out).items():
        assert folder.parent == out and folder.resolve().parent == out.resolve(), mesh
        assert folder.name.startswith("mesh")


def test_what_lies_where_results_go_is_never_deleted(grasps, tmp_path):
    """A page and meshes of the user's, beside a file that is called like the record of grasps."""
    mine = {"grasps.json": '{"grasps": [1]}', "index.html": "mine", "meshes/object.ply": "mine", "meshes/a.ply": "mine"}
    (tmp_path / "meshes").mkdir()
    for name, text in mine.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(UserError, match="is not of earlier results"):
        grasps.first(1).save(tmp_path)
    assert {str(p.relative_to(tmp_path)): p.read_text() for p in tmp_path.rglob("*") if p.is_file()} == mine


def test_folders_of_meshes_with_long_names_leave_room_for_temporary_ones(tmp_path):
    meshes = [tmp_path / a / f"{'é' * 124}x.obj" for a in "ab"]
    folders = [folder.name for folder in result_folders(meshes, tmp_path).values()]
    assert folders == ["é" * 120, "é" * 120 + "-2"]
    with filling(tmp_path / folders[1], ["grasps.json"], lambda _: True) as temporary:
        (temporary / "grasps.json").touch()
    assert (tmp_path / folders[1] / "grasps.json").exists()


@pytest.mark.parametrize("text", ["[]", "[" * 100_000, "{", '{"mesh": 3, "grasps": [], "definitions": {}}', "\udcff"])
def test_a_record_that_is_none_says_nothing(text, tmp_path):
    (tmp_path / RECORD).write_bytes(text.encode(errors="surrogateescape"))
    assert record_of(tmp_path) == {} and not has_results(tmp_path)
