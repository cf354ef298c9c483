"""The published data, written in its layout from known hands and objects, and read back from the store."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from grabnet.body.hand import OPEN_HANDS, HandModel
from grabnet.cli.entry import compose
from grabnet.data.datamodule import GraspDataModule
from grabnet.data.frames import FramesStore
from grabnet.data.objects import OBJECT_MESHES, object_files
from grabnet.data.sources.base import write_store
from grabnet.data.sources.grabnet_release import GrabnetRelease, read_frame_names
from grabnet.data.splits import Split
from grabnet.errors import UserError
from grabnet.geometry.mesh import load_mesh
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.io.npz import read_npz
from grabnet.training.refine_inputs import StoredNoise
from grabnet.training.run import train
from tests.tiny import tiny_overrides

# (subject, sequence, frame) of each split, not in order.
FRAMES = {
    "train": [("s1", "ball_pass_1", 30), ("s2", "can_offhand_use_2", 7), ("s1", "ball_pass_1", 10)],
    "val": [("s1", "ring_lift_1", 1), ("s2", "ring_use_1", 2)],
    "test": [("s2", "block_use_1", 4)],
}


def write_release(folder, meshes, by_rows=True):
    """Random grasps in the published layout; what they show comes back for comparison."""
    hand, rng = HandModel.open(), np.random.default_rng(0)
    subjects = {f"s{k}": hand.shaped(torch.randn(10, generator=torch.Generator().manual_seed(k))) for k in (1, 2)}
    info = {name: {"rh_vtemp": v.numpy(), "rh_betas": np.zeros(10), "gender": "male"} for name, v in subjects.items()}
    (folder / "data").mkdir(parents=True)
    np.save(folder / "data" / "sbj_info.npy", np.array(info, dtype=object))
    shown = {}
    for split, frames in FRAMES.items():
        n = len(frames)
        wrist, fingers = (Rotation.random(n * k, rng).as_matrix().reshape(n, k, 3, 3) for k in (1, 15))
        object_turn = Rotation.random(n, rng).as_matrix()
        transl, object_transl = rng.normal(0, 0.1, (2, n, 3))
        points, vertices, noisy_vertices = np.zeros((n, 2048, 3)), np.zeros((n, 778, 3)), np.zeros((n, 778, 3))
        shake, noisy_transl = (
            Rotation.from_rotvec(rng.normal(0, 0.1, (16 * n, 3))),
            transl + rng.normal(0, 0.01, (n, 3)),
        )
        noisy = np.concatenate([wrist, fingers], 1) @ shake.as_matrix().reshape(n, 16, 3, 3)
        for k, (subject, take, frame) in enumerate(frames):
            mesh = load_mesh(object_files(meshes)[take.split("_")[0]])
            turn = object_turn[k] if by_rows else object_turn[k].T
            points[k] = mesh.sample_surface(2048, k)[0] @ turn + object_transl[k]
            world = mesh.vertices @ turn + object_transl[k]
            for posed, joints, place in (
                (vertices, np.concatenate([wrist[k], fingers[k]]), transl),
                (noisy_vertices, noisy[k], noisy_transl),
            ):
                rotations, placed = torch.tensor(joints[None]).float(), torch.tensor(place[k : k + 1]).float()
                posed[k] = hand.pose(rotations, placed, subjects[subject])[0][0]
            centre = world.mean(0)
            both = (vertices[k] - centre, noisy_vertices[k] - centre)
            shown[f"{subject}/{take}", frame] = (*both, world - centre, mesh.vertices)
        (folder / "data" / split).mkdir()
        np.savez_compressed(
            folder / "data" / split / f"grabnet_{split}.npz",
            global_orient_rhand_rotmat=wrist.astype(np.float32),
            fpose_rhand_rotmat=fingers.astype(np.float32),
            trans_rhand=transl.astype(np.float32),
            global_orient_rhand_rotmat_f=noisy[:, :1],
            fpose_rhand_rotmat_f=noisy[:, 1:],
            trans_rhand_f=noisy_transl,
            root_orient_obj_rotmat=object_turn.astype(np.float32),
            trans_obj=object_transl.astype(np.float32),
            verts_rhand=vertices.astype(np.float32),
            verts_rhand_f=noisy_vertices.astype(np.float32),
            verts_object=points.astype(np.float32),
            bps_object=np.zeros((n, 4096), np.float32),
        )
        paths = [f"/somewhere/data/{split}/data/{s}/{take}/{frame:05d}.npz" for s, take, frame in frames]
        np.savez(folder / "data" / split / "frame_names.npz", frame_names=np.array(paths))
    return shown


@pytest.fixture
def meshes(tiny_dataset):
    return tiny_dataset / OBJECT_MESHES


def convert(release, root, meshes, hand=None, noisy=True):
    write_store(root, GrabnetRelease(str(release), str(meshes), hand or HandModel.open(), noisy))
    return FramesStore.load(root / "frames")


@pytest.mark.parametrize("by_rows", [True, False])
def test_the_store_shows_what_the_release_shows(tmp_path, meshes, by_rows):
    shown = write_release(tmp_path / "release", meshes, by_rows)
    store, hand = convert(tmp_path / "release", tmp_path / "root", meshes), HandModel.open()
    frames = store.frames
    assert len(frames) == len(shown) == 6
    assert store.objects == ["ball", "block", "can", "ring"] and store.subjects == ["s1", "s2"]
    assert [store.frames.frame[k] for k in range(2)] == [10, 30], "in order within a sequence"
    vertices, noisy = (hand(h, store.v_template[frames.subject]).vertices for h in (frames.hand(), frames.noisy_hand()))
    turns = axis_angle_to_matrix(frames.object_orient)
    for k in range(6):
        expected_hand, expected_noisy, expected_object, mesh = shown[
            store.sequences[frames.sequence[k]], frames.frame[k].item()
        ]
        np.testing.assert_allclose(vertices[k], expected_hand, atol=2e-5)
        np.testing.assert_allclose(noisy[k], expected_noisy, atol=8e-5)  # half precision
        np.testing.assert_allclose((mesh - mesh.mean(0)) @ turns[k].numpy().T, expected_object, atol=2e-5)
    check = store.card["provenance"]["hand_vertices_mm"]
    for off in (check[split][kind] for split in FRAMES for kind in ("true", "noisy")):
        assert 0 <= off["mean"] <= off["max"] < 0.01


def test_it_is_converted_once(tmp_path, meshes):
    write_release(tmp_path / "release", meshes)
    convert(tmp_path / "release", tmp_path / "root", meshes)
    card = tmp_path / "root/frames/store.json"
    stamp = card.stat().st_mtime_ns
    convert(tmp_path / "release/data", tmp_path / "root", meshes)
    assert card.stat().st_mtime_ns == stamp


def test_noisy_hands_are_what_refinenet_starts_from(tmp_path, meshes, cache_dir):
    shown = write_release(tmp_path / "release", meshes)
    store, hand = convert(tmp_path / "release", tmp_path / "root", meshes), HandModel.open()
    split = {"split": Split("object", ["ring"], ["block"]), "objects_dir": str(meshes)}
    data = GraspDataModule(hand, str(tmp_path / "root"), **split, object_points=64, cache_dir=str(cache_dir))
    data.setup()
    index = torch.arange(3)
    still, turned = (data.assemble("train", index, turn) for turn in (False, True))
    start = hand(StoredNoise()(still, hand).noisy, still.rest).vertices
    frames = data.frames("train")
    for k in range(3):
        _, noisy, _, _ = shown[store.sequences[frames.sequence[k]], frames.frame[k].item()]
        np.testing.assert_allclose(start[k], noisy, atol=8e-5)
    # Turned with all else.
    moved = hand(StoredNoise()(turned, hand).noisy, turned.rest).vertices
    torch.testing.assert_close(
        (moved - turned.vertices).norm(dim=-1), (start - still.vertices).norm(dim=-1), atol=1e-4, rtol=0
    )
    overrides = tiny_overrides(tmp_path / "root", tmp_path / "run", cache_dir, "refinenet", "trainer.max_epochs=1")
    swapped = [o for o in overrides if "split" not in o]
    metrics = train(compose("train", [
        *swapped, "data.split.val=[ring]", "data.split.test=[block]", f"objects.dir={meshes}",
        "source=published", "callbacks.grasps=null",
    ]))  # fmt: skip
    assert metrics["test/train/v2v"] > 0


def test_noisy_hands_may_be_left_out(tmp_path, meshes, cache_dir):
    write_release(tmp_path / "release", meshes)
    store = convert(tmp_path / "release", tmp_path / "root", meshes, noisy=False)
    assert store.frames.noisy is None
    data = GraspDataModule(
        HandModel.open(), str(tmp_path / "root"), Split("object", ["ring"], ["block"]), str(meshes), object_points=64,
        cache_dir=str(cache_dir),
    )  # fmt: skip
    data.setup()
    with pytest.raises(UserError, match="holds no noisy hands"):
        StoredNoise()(data.assemble("train", torch.arange(2)), data.hand)


def test_another_hand_is_told(tmp_path, meshes):
    """One that bends elsewhere; the subjects' templates are in the release."""
    write_release(tmp_path / "release", meshes)
    arrays = read_npz(OPEN_HANDS / "MANO_RIGHT.npz")
    np.savez(tmp_path / "MANO_RIGHT.npz", **arrays | {"weights": np.roll(arrays["weights"], 1, axis=1)})
    with pytest.raises(UserError, match=r"grabnet_train\.npz: hands made of its poses lie \d+\.\d mm off"):
        convert(tmp_path / "release", tmp_path / "root", meshes, HandModel(tmp_path / "MANO_RIGHT.npz"))
    assert not (tmp_path / "root/frames/store.json").exists()


def test_other_meshes_are_told(tmp_path, meshes):
    write_release(tmp_path / "release", meshes)
    (tmp_path / "meshes").mkdir()
    for name in ("ball", "block", "can", "ring"):
        (tmp_path / "meshes" / f"{name}.ply").write_bytes((meshes / "block.ply").read_bytes())
    with pytest.raises(UserError, match=r"its object points lie \d+\.\d mm off the meshes of objects\.dir"):
        convert(tmp_path / "release", tmp_path / "root", tmp_path / "meshes")


def change(path, **arrays):
    with np.load(path) as stored:
        content = dict(stored) | arrays
    np.savez(path, **{k: v for k, v in content.items() if v is not None})


@pytest.mark.parametrize(
    ("arrays", "sentence"),
    [
        ({"trans_rhand": None}, "has no array trans_rhand"),
        ({"trans_obj": np.zeros((2, 3))}, r"trans_obj is of shape \(2, 3\), or not finite; expected \(3, 3\)"),
        ({"fpose_rhand_rotmat": np.zeros((3, 14, 3, 3))}, "fpose_rhand_rotmat is of shape"),
        ({"trans_rhand": np.full((3, 3), np.nan)}, "trans_rhand is of shape .*, or not finite"),
        ({"verts_rhand": np.zeros((3, 700, 3))}, "verts_rhand has rows"),
        ({"trans_rhand_f": None}, "has no array trans_rhand_f"),
        ({"verts_rhand_f": np.zeros((3, 778, 3))}, r"lie \d+\.\d mm off its verts_rhand_f"),
    ],
)
def test_damaged_arrays_are_told(tmp_path, meshes, arrays, sentence):
    write_release(tmp_path / "release", meshes)
    change(tmp_path / "release/data/train/grabnet_train.npz", **arrays)
    with pytest.raises(UserError, match=sentence):
        convert(tmp_path / "release", tmp_path / "root", meshes)


def test_unknown_subjects_and_objects_are_told(tmp_path, meshes):
    write_release(tmp_path / "release", meshes)
    names = tmp_path / "release/data/val/frame_names.npz"
    for bad, sentence in (("s9/ring_use_1/00001", "subjects .* s9"), ("s1/teapot_use_1/00001", "objects .* teapot")):
        np.savez(names, frame_names=np.array([f"/data/{bad}.npz"] * 2))
        with pytest.raises(UserError, match=sentence):
            convert(tmp_path / "release", tmp_path / "root", meshes)


@pytest.mark.parametrize("name", ["ring_use_1/00001.npz", "s1/ring/00001.npz", "s1/ring_use_1/last.npz", ""])
def test_other_frame_names_are_told(tmp_path, name):
    np.savez(tmp_path / "frame_names.npz", frame_names=np.array([name]))
    with pytest.raises(UserError, match="is no frame name like"):
        read_frame_names(tmp_path / "frame_names.npz")


def test_the_config_names_what_it_needs():
    with pytest.raises(UserError, match=r"data\.source\.release must be given"):
        compose("train", ["model=coarsenet", "data=grabnet_release", "run_dir=x", "objects.dir=y"])
    cfg = compose("train", ["data=grabnet_release", "run_dir=x", "objects.dir=y", "data.source.release=z"])
    assert cfg.data.source.objects_dir == "y" and cfg.data.source.hand.side == "right"
