"""The published data, written in each of its layouts from known hands and objects, and read back from the store."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
import torch
import trimesh

from grabnet.body.hand import OPEN_HANDS, HandModel
from grabnet.cli.entry import CONFIGS, compose
from grabnet.data.datamodule import GraspDataModule
from grabnet.data.frames import FramesStore
from grabnet.data.objects import object_files
from grabnet.data.sources.base import write_store
from grabnet.data.sources.grabnet_release import GrabnetRelease
from grabnet.data.sources.release_comparison import sample_rows
from grabnet.data.sources.release_names import FrameName, read_frame_names
from grabnet.data.splits import Split
from grabnet.errors import UserError
from grabnet.geometry.mesh import load_mesh
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.io.npz import read_npz
from grabnet.training.refine_inputs import StoredNoise
from tests.data.published import FRAMES, hand_file, write_objects, write_release, zip_release
from tests.faults import DiesPublishing
from tests.processes import finish
from tests.tiny import tiny_overrides

# Enough frames for several blocks of the comparison.
MANY = {
    "train": [(f"s{1 + k % 2}", f"{('ball', 'can')[k % 3 % 2]}_pass_{k % 4}", k) for k in range(150)],
    "val": [("s1", "ring_lift_1", k) for k in range(3)],
    "test": [("s2", "block_use_1", k) for k in range(3)],
}


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    return write_objects(tmp_path_factory.mktemp("meshes"))


@pytest.fixture(scope="module")
def published(tmp_path_factory, meshes):
    """A release in its true layout; not to be written to."""
    folder = tmp_path_factory.mktemp("release")
    return folder, write_release(folder, meshes)


@pytest.fixture(scope="module")
def many(tmp_path_factory, meshes):
    """A release of more frames, and the data set that it gives in one go; neither to be written to."""
    folder = tmp_path_factory.mktemp("many")
    write_release(folder / "release", meshes, frames=MANY)
    convert(folder / "release", folder / "whole", meshes, check="all")
    return folder


@pytest.fixture
def release(published, tmp_path):
    """A copy, to be written to."""
    return shutil.copytree(published[0], tmp_path / "release")


def convert(release, root, meshes, hand=None, **options):
    write_store(root, GrabnetRelease(str(release), str(root), str(meshes), hand or HandModel.open(), **options))
    return FramesStore.load(root / "frames")


def files_of(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def check_shown(store, shown, meshes):
    """The store's hands and objects lie as the release's do, about the mean vertex of the object."""
    frames, hand = store.frames, HandModel.open()
    assert len(frames) == len(shown)
    vertices, noisy = (hand(h, store.v_template[frames.subject]).vertices for h in (frames.hand(), frames.noisy_hand()))
    turns = axis_angle_to_matrix(frames.object_orient)
    for k in range(len(frames)):
        expected = shown[store.sequences[frames.sequence[k]], frames.frame[k].item()]
        centre = expected.object.mean(0)
        mesh = load_mesh(object_files(meshes)[store.objects[frames.object[k]]])
        assert np.linalg.norm(mesh.centroid - mesh.bounds.mean(0)) > 0.03
        np.testing.assert_allclose(vertices[k], expected.vertices - centre, atol=1e-5)
        np.testing.assert_allclose(noisy[k], expected.noisy - centre, atol=8e-5)  # half precision
        ours = (mesh.vertices - mesh.centroid) @ turns[k].numpy().T
        np.testing.assert_allclose(ours, expected.object - centre, atol=1e-5)


def test_the_store_shows_what_the_release_shows(published, tmp_path, meshes):
    release, shown = published
    store = convert(release, tmp_path, meshes)
    check_shown(store, shown, meshes)
    assert store.objects == ["ball", "block", "can", "ring"] and store.subjects == ["s1", "s2"]
    assert [store.frames.frame[k] for k in range(2)] == [10, 30], "in order within a sequence"
    facts = store.card["provenance"]
    assert set(facts["layout"].values()) == {"parameters in one file, vertices and BPS in a file for each frame"}
    for split, frames in FRAMES.items():
        found = facts["compared"][split]
        assert found["frames"] == len(frames)
        off = found["off"]
        for name in ("verts_rhand", "verts_rhand_f", "verts_object"):
            assert 0 <= off[name]["mean_mm"] <= off[name]["max_mm"] < 1e-3
        assert 0 <= off["hand_to_object"]["max_mm"] < 1e-3  # the mock's foremost vertex is put on the surface
        assert 0.01 < off["bps_object"]["mean_mm"] < 1  # to 2048 points, and to the surface between them


@pytest.mark.parametrize("by_rows", [True, False])
@pytest.mark.parametrize("layout", ["frames", "one file", "parameters"])
def test_every_layout_gives_the_same_frames(published, tmp_path, meshes, layout, by_rows):
    shown = write_release(tmp_path / "release", meshes, layout, by_rows)
    store = convert(tmp_path / "release", tmp_path / "root", meshes)
    facts = store.card["provenance"]
    assert facts["compared"]["train"]["off"]["hand_to_object"]["mean_mm"] < 10
    if layout == "parameters":  # with nothing to compare, rotations are GRAB's
        assert set(facts["compared"]["train"]["off"]) == {"hand_to_object"}
        assert set(facts["layout"].values()) == {"parameters only"}
        assert facts["object_rotations"] == "for row vectors"
    else:
        assert facts["compared"]["train"]["off"]["verts_object"]["max_mm"] < 1e-3
        assert facts["object_rotations"] == f"for {'row' if by_rows else 'column'} vectors"
    if layout != "parameters" or by_rows:
        check_shown(store, shown, meshes)
    if by_rows:
        convert(published[0], tmp_path / "usual", meshes)
        assert files_of(tmp_path / "root/frames/shards") == files_of(tmp_path / "usual/frames/shards")


def test_a_further_axis_of_one_is_read_alike(release, published, tmp_path, meshes):
    path = release / "data/train/grabnet_train.npz"
    arrays = read_npz(path)
    change(path, root_orient_obj_rotmat=arrays["root_orient_obj_rotmat"][:, None],
           global_orient_rhand_rotmat=arrays["global_orient_rhand_rotmat"][:, 0])  # fmt: skip
    check_shown(convert(release, tmp_path / "root", meshes), published[1], meshes)


def test_frames_may_go_unchecked(release, published, tmp_path, meshes):
    shutil.rmtree(release / "data/train/data/s1")
    with pytest.raises(UserError, match=r"00030\.npz is missing, though .*frame_names\.npz names it: .*check=0"):
        convert(release, tmp_path / "root", meshes)
    store = convert(release, tmp_path / "root", meshes, check=0)
    check_shown(store, published[1], meshes)
    assert store.card["provenance"]["compared"] == {}


def test_it_is_converted_once(published, tmp_path, meshes):
    convert(published[0], tmp_path, meshes)
    card = tmp_path / "frames/store.json"
    stamp = card.stat().st_mtime_ns
    convert(published[0] / "data", tmp_path, meshes)
    assert card.stat().st_mtime_ns == stamp
    with pytest.raises(UserError, match=r"started with check=512, now it is all: delete .*frames"):
        convert(published[0], tmp_path, meshes, check="all")


def test_samples_are_spread_over_subjects_and_objects():
    names = [FrameName("s1", "mug_pass_1", "1.npz")] * 1000 + [FrameName("s2", "cup_pass_1", "1.npz")] * 3
    names += [FrameName("s2", "mug_pass_1", "1.npz")] * 50
    rows = sample_rows(names, 30, [0])
    assert len(rows.unique()) == 30 and torch.equal(rows[:7], sample_rows(names, 7, [0]))
    pairs = [(names[row].subject, names[row].object) for row in rows]
    assert pairs.count(("s2", "cup")) == 3 and 13 <= pairs.count(("s2", "mug")) <= 14
    assert len({*pairs[:3]}) == 3
    assert not torch.equal(rows, sample_rows(names, 30, [1]))
    assert sorted(sample_rows(names, 5000, [0]).tolist()) == list(range(1053))


def test_noisy_hands_are_what_refinenet_starts_from(published, tmp_path, meshes, cache_dir):
    release, shown = published
    store, hand = convert(release, tmp_path, meshes), HandModel.open()
    split = {"split": Split("object", ["ring"], ["block"]), "objects_dir": str(meshes)}
    data = GraspDataModule(hand, str(tmp_path), **split, object_points=64, cache_dir=str(cache_dir))
    data.setup()
    index = torch.arange(3)
    still, turned = (data.assemble("train", index, turn) for turn in (False, True))
    start = hand(StoredNoise()(still, hand).noisy, still.rest).vertices
    frames = data.frames("train")
    for k in range(3):
        expected = shown[store.sequences[frames.sequence[k]], frames.frame[k].item()]
        np.testing.assert_allclose(start[k], expected.noisy - expected.object.mean(0), atol=8e-5)
    # Turned with all else.
    moved = hand(StoredNoise()(turned, hand).noisy, turned.rest).vertices
    torch.testing.assert_close(
        (moved - turned.vertices).norm(dim=-1), (start - still.vertices).norm(dim=-1), atol=1e-4, rtol=0
    )


def test_noisy_hands_may_be_left_out(published, tmp_path, meshes, cache_dir):
    store = convert(published[0], tmp_path, meshes, noisy=False)
    assert store.frames.noisy is None and "verts_rhand_f" not in store.card["provenance"]["compared"]["train"]["off"]
    data = GraspDataModule(
        HandModel.open(), str(tmp_path), Split("object", ["ring"], ["block"]), str(meshes), object_points=64,
        cache_dir=str(cache_dir),
    )  # fmt: skip
    data.setup()
    with pytest.raises(UserError, match="holds no noisy hands"):
        StoredNoise()(data.assemble("train", torch.arange(2)), data.hand)


# From the downloads to a step of training.


def command(root, run_dir, cache_dir, model, *more):
    """Values for `train.py`: one epoch on the published data."""
    values = tiny_overrides(root, run_dir, cache_dir, model, "trainer.max_epochs=1", "callbacks.grasps=null", *more)
    values = [value for value in values if not value.startswith(("data=", "data.split"))]
    return ["data=grabnet_release", "data.split.val=[ring]", "data.split.test=[block]", *values]


def test_from_zip_files_to_a_trained_step(published, tmp_path, meshes, cache_dir):
    """The commands of README's section "With licensed files", on a mock of these."""
    downloads, root = zip_release(published[0], meshes, tmp_path / "downloads"), tmp_path / "GRAB"
    subprocess.run([sys.executable, CONFIGS.parent / "scripts/unpack_grab.py", downloads, root], check=True)
    assert files_of(root / "data") == files_of(published[0] / "data")
    files = [f"hand_model.path={hand_file(tmp_path / 'models')}", f"data.source.release={root}"]
    files += ["hand_model=mano", f"objects.dir={root / 'tools/object_meshes/contact_meshes'}"]
    log = tmp_path / "log.txt"
    for model, more in (("coarsenet", []), ("refinenet", ["source=published"])):
        values = command(tmp_path / "root", tmp_path / model, cache_dir, model, *files, *more)
        assert finish(values, log) == 0, log.read_text()
        metrics = json.loads((tmp_path / model / "metrics.json").read_text())
        assert metrics["test/train/v2v"] > 0
    found = "train: parameters in one file, vertices and BPS in a file for each frame. 3 of 3 frames compared, "
    assert log.read_text().count(found + "millimetres off: hand_to_object 0.0000 (at most 0.000") == 1
    check_shown(FramesStore.load(tmp_path / "root/frames"), published[1], meshes)


@pytest.mark.parametrize(("at", "n"), [("*/compared.json", 3), ("*/shards/*", 2)])
def test_a_killed_call_is_continued_to_the_same_bytes(many, tmp_path, meshes, cache_dir, at, n):
    shutil.copytree(many / "release", tmp_path / "release")
    release = [f"data.source.release={tmp_path / 'release'}", f"objects.dir={meshes}", "data.source.check=all"]
    values, log = command(tmp_path / "root", tmp_path / "run", cache_dir, "coarsenet", *release), tmp_path / "log.txt"
    assert finish(values, log, DiesPublishing(at, n)) == -signal.SIGKILL, log.read_text()
    found = json.loads((tmp_path / "root/frames/compared.json").read_text())["splits"]
    if "compared" in at:
        assert found["train"]["frames"] == 64
        # What was compared is not read again.
        (tmp_path / "release/data/train/data/s2/can_pass_1/00001.npz").write_bytes(b"changed")
    else:
        assert {split: found[split]["frames"] for split in MANY} == {"train": 150, "val": 3, "test": 3}
        shutil.rmtree(tmp_path / "release/data/val/data/s1")
    convert(tmp_path / "release", tmp_path / "root", meshes, check="all")
    assert files_of(tmp_path / "root/frames") == files_of(many / "whole/frames")


# What is refused.


def test_another_hand_is_refused_and_the_right_one_taken_after_it(published, tmp_path, meshes):
    """One that bends elsewhere; the subjects' templates are in the release."""
    arrays = read_npz(OPEN_HANDS / "MANO_RIGHT.npz")
    np.savez(tmp_path / "MANO_RIGHT.npz", **arrays | {"weights": np.roll(arrays["weights"], 1, axis=1)})
    sentence = (
        r"data/train/data/s\d/\w+/000\d\d\.npz: its verts_rhand lies \d+\.\d mm off what its parameters give "
        r"\(\d+\.\d mm at most; on average 1 mm are tolerated\): pass the model that the data were made with: "
        r"hand_model=mano hand_model\.path=<MANO_RIGHT\.npz>\.$"
    )
    with pytest.raises(UserError, match=sentence):
        convert(published[0], tmp_path / "root", meshes, HandModel(tmp_path / "MANO_RIGHT.npz"))
    assert not (tmp_path / "root/frames/store.json").exists()
    check_shown(convert(published[0], tmp_path / "root", meshes), published[1], meshes)


def test_other_meshes_are_refused(published, tmp_path, meshes):
    (tmp_path / "meshes").mkdir()
    for name in ("ball", "block", "can", "ring"):
        (tmp_path / "meshes" / f"{name}.ply").write_bytes((meshes / "block.ply").read_bytes())
    with pytest.raises(
        UserError, match=r"its verts_object lies \d+\.\d mm off .* objects\.dir=<GRAB's contact_meshes>"
    ):
        convert(published[0], tmp_path / "root", tmp_path / "meshes")


def change(path, **arrays):
    content = read_npz(path) | arrays
    np.savez(path, **{k: v for k, v in content.items() if v is not None})


def test_hands_far_from_their_objects_are_refused(tmp_path, meshes):
    """Nothing but parameters, and meshes of other objects."""
    write_release(tmp_path / "release", meshes, "parameters", frames=MANY)
    (tmp_path / "meshes").mkdir()
    for name in ("ball", "block", "can", "ring"):
        trimesh.creation.icosphere(1, 0.005).export(tmp_path / "meshes" / f"{name}.ply")
    with pytest.raises(UserError, match=r"data/train: hands posed from its parameters are \d\d\.\d mm from their obj"):
        convert(tmp_path / "release", tmp_path / "root", tmp_path / "meshes")


def test_one_frame_that_disagrees_is_named(release, tmp_path, meshes):
    for name, by in (("verts_rhand", 0.002), ("verts_object", 0.05), ("bps_object", 0.005)):
        path = release / "data/train/data/s2/can_offhand_use_2/00007.npz"
        kept = path.read_bytes()
        change(path, **{name: read_npz(path)[name] + by})
        with pytest.raises(UserError, match=rf"s2/can_offhand_use_2/00007\.npz: its {name} lies"):
            convert(release, tmp_path / "root", meshes)
        path.write_bytes(kept)


def test_one_row_that_disagrees_is_named(tmp_path, meshes):
    write_release(tmp_path / "release", meshes, "one file")
    path = tmp_path / "release/data/val/grabnet_val.npz"
    vertices = read_npz(path)["verts_rhand"]
    vertices[1] += 0.002
    change(path, verts_rhand=vertices)
    with pytest.raises(UserError, match=r"grabnet_val\.npz \(row 1\): its verts_rhand lies 3\.5 mm off"):
        convert(tmp_path / "release", tmp_path / "root", meshes)


def test_an_array_of_too_few_rows_is_named(tmp_path, meshes):
    write_release(tmp_path / "release", meshes, "one file")
    path = tmp_path / "release/data/val/grabnet_val.npz"
    change(path, verts_rhand=read_npz(path)["verts_rhand"][:1])
    with pytest.raises(UserError, match=r"grabnet_val\.npz: verts_rhand has no row 1: download it again"):
        convert(tmp_path / "release", tmp_path / "root", meshes)


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("sbj_info.npy", None, r"sbj_info\.npy is missing: unpack the whole release"),
        ("val/frame_names.npz", None, r"val/frame_names\.npz is missing: unpack the whole release"),
        ("val/grabnet_val.npz", None, r"grabnet_val\.npz is missing: unpack the whole release"),
        ("val/grabnet_val.npz", b"PK\3\4cut", r"grabnet_val\.npz is not a readable \.npz file"),
        ("val/data/s1/ring_lift_1/00001.npz", None, r"ring_lift_1/00001\.npz is missing, .*data\.source\.check=0"),
        ("val/data/s1/ring_lift_1/00001.npz", b"PK\3\4cut", r"ring_lift_1/00001\.npz is not a readable"),
        ("bps.npz", b"cut", r"bps\.npz is not a readable \.npz file"),
        ("sbj_info.npy", np.array([1, 2]), r"sbj_info\.npy holds a ndarray, expected a dict of subjects"),
        ("sbj_info.npy", {"s1": {"rh_vtemp": np.zeros((7, 3))}}, r"rh_vtemp of s1 has shape \(7, 3\)"),
        ("sbj_info.npy", {"s1": {"rh_vtemp": np.full((778, 3), np.nan)}}, "rh_vtemp of s1 .* no finite numbers"),
        ("sbj_info.npy", {"s1": {"rh_vtemp": np.full((778, 3), "x")}}, "rh_vtemp of s1 .* no finite numbers"),
        ("sbj_info.npy", {"s1": np.random.default_rng(0)}, r"sbj_info\.npy holds a pickled numpy.* is not loaded"),
    ],
)  # fmt: skip
def test_pieces_that_are_missing_or_damaged_are_named(release, tmp_path, meshes, name, content, sentence):
    path = release / "data" / name
    path.unlink()
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        np.save(path, content if isinstance(content, np.ndarray) else np.array(content, object), allow_pickle=True)
    with pytest.raises(UserError, match=sentence):
        convert(release, tmp_path / "root", meshes)
    assert not (tmp_path / "root/frames/store.json").exists()


@pytest.mark.parametrize(
    ("file", "arrays", "sentence"),
    [
        ("grabnet_train.npz", {"trans_rhand": None}, r"grabnet_train\.npz has no array trans_rhand"),
        ("grabnet_train.npz", {"trans_obj": np.zeros((2, 3))}, "trans_obj has 2 rows, and .*names 3 frames"),
        ("grabnet_train.npz", {"fpose_rhand_rotmat": np.zeros((3, 14, 3, 3))}, "fpose_rhand_rotmat has shape"),
        ("grabnet_train.npz", {"trans_rhand": np.full((3, 3), np.nan)}, "trans_rhand holds values that are not finite"),
        ("grabnet_train.npz", {"trans_rhand": np.full((3, 3), "x")}, "trans_rhand holds values that are not finite"),
        ("grabnet_train.npz", {"trans_rhand_f": None}, "has no array trans_rhand_f"),
        ("grabnet_train.npz", {"verts_rhand": np.zeros((3, 700, 3))}, "verts_rhand has shape"),
        ("data/s1/ball_pass_1/00010.npz", {"verts_object": None}, r"00010\.npz has no array verts_object: unpack"),
        ("data/s1/ball_pass_1/00010.npz", {"verts_object": np.zeros((2000, 3))}, r"00010\.npz: verts_object has shape"),
        ("data/s1/ball_pass_1/00010.npz", {"more": np.zeros(10**6)}, r"00010\.npz unpacks to .* bytes; at most"),
    ],
)  # fmt: skip
def test_damaged_arrays_are_named(release, tmp_path, meshes, file, arrays, sentence):
    change(release / "data/train" / file, **arrays)
    with pytest.raises(UserError, match=sentence):
        convert(release, tmp_path / "root", meshes)


def test_unknown_subjects_and_objects_are_named(release, tmp_path, meshes):
    names = release / "data/val/frame_names.npz"
    for bad, sentence in (("s9/ring_use_1/00001", r"subjects that .*sbj_info\.npy does not have: s9; it has s1, s2"),
                          ("s1/teapot_use_1/00001", r"objects that objects\.dir=.* teapot")):  # fmt: skip
        np.savez(names, frame_names=np.array([f"/data/{bad}.npz"] * 2))
        with pytest.raises(UserError, match=sentence):
            convert(release, tmp_path / "root", meshes)


def test_a_recording_in_two_splits_is_refused(release, tmp_path, meshes):
    shutil.copy(release / "data/train/frame_names.npz", release / "data/val/frame_names.npz")
    with pytest.raises(UserError, match=r"s\d/\w+ is in train and in val"):
        convert(release, tmp_path / "root", meshes)


@pytest.mark.parametrize(
    "name",
    [
        "ring_use_1/00001.npz", "s1/ring/00001.npz", "s1/ring_use_1/last.npz", "", "/a/../ring_use_1/1.npz",
        "/a/s1/../1.npz", "/a/s1/ring_use_1/..", "/a/s1/ring_use_1/../1.npz", "/a/s1/.ring_use_1/1.npz",
        "/a/s1/ring\0use_1/1.npz", "/a/s\0/ring_use_1/1.npz", "/a/s1/ring_use_1/1\0.npz",
        f"/a/s1/ring_{300 * 'x'}_1/1.npz", f"/a/{300 * 's'}/ring_use_1/1.npz",
        f"/a/s1/ring_use_1/{300 * '1'}.npz", "/a/s1/ring_use_1/1.npz\n",
        "a\\s1\\r_u_1\\1.npz",
    ],
)  # fmt: skip
def test_other_frame_names_are_refused(tmp_path, name):
    np.savez(tmp_path / "frame_names.npz", frame_names=np.array([name], dtype=object))
    with pytest.raises(UserError, match="is no frame name like") as error:
        read_frame_names(tmp_path / "frame_names.npz")
    assert len(str(error.value)) < 400 and "\0" not in str(error.value)


@pytest.mark.parametrize("prefix", ["", "/", "/home/x/../y/", "C:/data/", f"/{5000 * 'x'}/", "/a\0b/"])
def test_what_stands_before_a_frame_name_is_of_no_matter(tmp_path, prefix):
    np.savez(tmp_path / "frame_names.npz", frame_names=np.array([f"{prefix}s1/mug_offhand_use_1/0012.npz"], object))
    (name,) = read_frame_names(tmp_path / "frame_names.npz")
    assert name == FrameName("s1", "mug_offhand_use_1", "0012.npz")
    assert (name.sequence, name.object, name.action, name.frame) == ("s1/mug_offhand_use_1", "mug", "offhand_use", 12)


def test_lists_of_other_form_are_refused(tmp_path):
    for arrays in ({}, {"a": np.array(["x"]), "b": np.array(["x"])}, {"frame_names": np.array([], "U9")}):
        np.savez(tmp_path / "frame_names.npz", **arrays)
        with pytest.raises(UserError, match="expected one list of frame names"):
            read_frame_names(tmp_path / "frame_names.npz")


def test_a_damaged_record_is_named(published, tmp_path, meshes):
    convert(published[0], tmp_path, meshes)
    (tmp_path / "frames/store.json").unlink()
    (tmp_path / "frames/compared.json").write_text("{}")
    with pytest.raises(UserError, match=r"compared\.json is damaged .*: delete it"):
        convert(published[0], tmp_path, meshes)


def test_the_config_names_what_it_needs():
    with pytest.raises(UserError, match=r"data\.source\.release must be given"):
        compose("train", ["model=coarsenet", "data=grabnet_release", "run_dir=x", "objects.dir=y"])
    cfg = compose("train", ["data=grabnet_release", "run_dir=x", "objects.dir=y", "data.source.release=z"])
    assert cfg.data.source.objects_dir == "y" and cfg.data.source.hand.side == "right"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"check": -1}, r"data\.source\.check is -1"),
        ({"check": "some"}, r"data\.source\.check is some; it must be a number of frames, 0 or more, or all"),
        ({"tolerance": -1.0}, r"data\.source\.tolerance is -1\.0; it must be at least 0"),
        ({"bps_tolerance": float("nan")}, r"data\.source\.bps_tolerance is nan"),
    ],
)
def test_values_out_of_range_are_refused(options, sentence, hand):
    with pytest.raises(UserError, match=sentence):
        GrabnetRelease("x", "y", "z", hand, **options)
