"""Batches are checked against the frames posed one by one and measured against the exact mesh."""

from pathlib import Path

import lightning as L
import pytest
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from grabnet.body.hand import HandParameters
from grabnet.data.datamodule import GraspDataModule, IndexBatches
from grabnet.data.frames import finish_store, write_shard
from grabnet.data.objects import OBJECT_MESHES
from grabnet.data.splits import Split
from grabnet.errors import UserError
from grabnet.geometry.mesh import load_mesh
from grabnet.geometry.queries import MeshQuery
from tests.data.test_frames import shard_values

SPLIT = {"split": Split("object", ["can"], ["ring"])}


@pytest.fixture(scope="module")
def data(tiny_dataset, hand, cache_dir) -> GraspDataModule:
    module = GraspDataModule(
        hand, str(tiny_dataset), **SPLIT, batch_size=16, object_points=64, cache_dir=str(cache_dir)
    )
    module.setup()
    return module


def test_objects_are_split_by_name(data):
    names = data.store.objects
    assert {split: {names[i] for i in data.frames(split).object} for split in ("train", "val", "test")} == {
        "train": {"ball", "block"},
        "val": {"can"},
        "test": {"ring"},
    }


def test_distances_are_those_to_the_mesh(data, tiny_dataset):
    index = torch.arange(0, 96, 17)
    batch = data.assemble("train", index)
    frames = data.frames("train").select(index)
    for k in range(len(index)):
        mesh = load_mesh(tiny_dataset / OBJECT_MESHES / f"{data.store.objects[frames.object[k]]}.ply")
        rotation = Rotation.from_rotvec(frames.object_orient[k].numpy())
        # The frame's world is centred on the mean of the object's turned vertices (ref. 3).
        world = rotation.inv().apply(batch.vertices[k].numpy()) + mesh.vertices.mean(0)
        exact = MeshQuery(mesh).signed_distance(torch.as_tensor(world, dtype=torch.float32))
        assert (batch.distances[k] - exact).abs().mean() < 2e-4
        torch.testing.assert_close(batch.objects.distances(batch.vertices)[k], batch.distances[k], atol=1e-4, rtol=1e-3)


def test_distances_may_be_to_the_samples_as_published(tiny_dataset, hand, cache_dir):
    settings = {"object_points": 64, "distance_to": "samples", "cache_dir": str(cache_dir)}
    data = GraspDataModule(hand, str(tiny_dataset), **SPLIT, **settings)
    data.setup()
    batch = data.assemble("train", torch.arange(3), turn=True)
    for k in range(3):
        samples = data.assembler.object_set.points[batch.objects.index[k]] @ batch.objects.rotations[k].mT
        expected, _ = cKDTree(samples.numpy()).query(batch.vertices[k].numpy())
        for found in (batch.distances[k], batch.objects.distances(batch.vertices)[k]):
            torch.testing.assert_close(found.double(), torch.from_numpy(expected), atol=1e-4, rtol=1e-3)
    with pytest.raises(UserError, match=r"data\.distance_to is 'meters'"):
        GraspDataModule(hand, str(tiny_dataset), **SPLIT, **(settings | {"distance_to": "meters"})).setup()


def test_points_are_the_samples_and_their_distances_exact(data):
    batch = data.assemble("train", torch.arange(5))
    torch.testing.assert_close(
        batch.points, data.assembler.object_set.points[batch.objects.index] @ batch.objects.rotations.mT
    )
    for points, vertices, distances in zip(batch.points, batch.vertices, batch.point_distances, strict=True):
        expected, _ = cKDTree(vertices.numpy()).query(points.numpy())
        assert abs(distances.abs().numpy() - expected).max() < 1e-4


def test_turning_about_the_vertical_changes_no_distance(data):
    index = torch.arange(8)
    torch.manual_seed(3)
    still, turned = data.assemble("train", index), data.assemble("train", index, turn=True)
    assert (still.vertices - turned.vertices).abs().max() > 0.05
    torch.testing.assert_close(still.vertices[..., 2], turned.vertices[..., 2])
    torch.testing.assert_close(turned.objects.distances(turned.vertices), still.distances, atol=2e-4, rtol=0)
    assert torch.equal(turned.distances, still.distances)
    reposed = data.hand(HandParameters(*turned.hand), turned.rest).vertices
    torch.testing.assert_close(reposed, turned.vertices, atol=1e-5, rtol=0)


def test_contact_is_the_share_of_touching_frames(data):
    near = []
    for start in range(0, 96, 16):
        near.append(data.assemble("train", torch.arange(start, start + 16)).distances < 0.0045)
    torch.testing.assert_close(data.contact, torch.cat(near).float().mean(0), atol=1e-6, rtol=0)


def test_shuffled_batches_cover_all_once_and_repeat_by_epoch():
    batches = IndexBatches(50, 16, shuffle=True, seed=4)
    first = [index for index, _ in batches]
    assert len(batches) == 3 and len(torch.cat(first).unique()) == 48
    assert all(torch.equal(a, b) for a, (b, _) in zip(first, batches, strict=True))
    batches.set_epoch(1)
    assert not torch.equal(torch.cat(first), torch.cat([index for index, _ in batches]))


def test_an_epoch_of_many_steps_is_several_passes_each_in_its_own_order():
    batches = IndexBatches(50, 16, shuffle=True, seed=4, min_steps=7)
    steps = list(batches)
    passes = [torch.cat([index for index, _ in steps[k : k + 3]]) for k in (0, 3, 6)]
    assert len(batches) == len(steps) == 9 and len({seed for _, seed in steps}) == 9
    assert all(len(order.unique()) == 48 for order in passes)
    batches.set_epoch(1)
    orders = {tuple(order.tolist()) for order in passes} | {tuple(i.tolist()) for i, _ in batches}
    assert len(orders) == 3 + 9
    assert len(IndexBatches(50, 16, shuffle=False, seed=4, min_steps=7)) == 4


def test_evaluation_drops_no_frame():
    assert torch.cat([index for index, _ in IndexBatches(50, 16, shuffle=False, seed=0)]).tolist() == list(range(50))


def test_noise_is_new_in_every_epoch_of_training_and_never_in_evaluation():
    for shuffle in (True, False):
        batches = IndexBatches(50, 16, shuffle, seed=0)
        seeds = [seed for _, seed in batches]
        batches.set_epoch(1)
        again = [seed for _, seed in batches]
        assert len({*seeds, *again}) == (len(seeds) + len(again) if shuffle else len(seeds))


@pytest.mark.parametrize("world_size", [2, 3])
def test_processes_share_every_training_batch(world_size):
    whole = [index for index, _ in IndexBatches(50, 12, shuffle=True, seed=4)]
    shares = [list(IndexBatches(50, 12, True, 4, rank, world_size)) for rank in range(world_size)]
    for k, batch in enumerate(whole):
        parts = [share[k][0] for share in shares]
        assert {len(part) for part in parts} == {12 // world_size}
        assert sorted(torch.cat(parts).tolist()) == sorted(batch.tolist())
    assert {len(share) for share in shares} == {len(whole)}
    assert len({seed for share in shares for _, seed in share}) == world_size * len(whole)


@pytest.mark.parametrize(("n", "batch_size", "world_size"), [(50, 12, 3), (11, 4, 2), (5, 2, 2), (3, 8, 2), (2, 2, 2)])
def test_processes_evaluate_every_frame_once_in_as_many_batches(n, batch_size, world_size):
    shares = [[i for i, _ in IndexBatches(n, batch_size, False, 0, rank, world_size)] for rank in range(world_size)]
    assert sorted(torch.cat([i for share in shares for i in share]).tolist()) == list(range(n))
    assert len({len(share) for share in shares}) == 1
    assert all(0 < len(i) <= batch_size // world_size + 1 for share in shares for i in share)


@pytest.mark.parametrize(
    ("batch_size", "devices", "sentence"),
    [
        (16, 3, "data.batch_size=16 cannot be shared evenly among 3 processes; make it a multiple of 3"),
        (100, 100, "The 96 train frames are too few for 100 processes; set trainer.devices=96"),
    ],
)
def test_what_processes_cannot_share_is_an_error(batch_size, devices, sentence, tiny_dataset, hand, cache_dir):
    data = GraspDataModule(hand, str(tiny_dataset), **SPLIT, batch_size=batch_size, cache_dir=str(cache_dir))
    data.setup()
    data.trainer = L.Trainer(accelerator="cpu", devices=devices, strategy="ddp", logger=False)
    with pytest.raises(UserError, match=sentence):
        data.train_dataloader()


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"batch_size": 1}, r"data\.batch_size is 1; it must be at least 2\."),
        ({"min_steps": 0}, r"data\.min_steps is 0; it must be at least 1\."),
        ({"object_points": 0}, r"data\.object_points is 0; it must be at least 1\."),
        ({"max_frames": -1}, r"data\.max_frames is -1; it must be at least 2\."),
    ],
)
def test_wrong_values_are_told_at_once(values, sentence, hand):
    with pytest.raises(UserError, match=sentence):
        GraspDataModule(hand, "nowhere", **SPLIT, **values)


def test_missing_meshes_are_named(tiny_dataset, hand, tmp_path, cache_dir):
    (tmp_path / "ball.ply").write_bytes((tiny_dataset / OBJECT_MESHES / "ball.ply").read_bytes())
    data = GraspDataModule(hand, str(tiny_dataset), **SPLIT, objects_dir=str(tmp_path), cache_dir=str(cache_dir))
    with pytest.raises(UserError, match="no mesh for block, can, ring; it has ball"):
        data.setup()


def test_an_empty_split_is_an_error(tiny_dataset, hand, cache_dir):
    data = GraspDataModule(hand, str(tiny_dataset), Split("object", [], ["mug"]), cache_dir=str(cache_dir))
    with pytest.raises(UserError, match=r"no val frames.*name some in data\.split\.val"):
        data.setup()


def test_one_training_frame_is_too_few(tiny_dataset, hand, cache_dir, tmp_path):
    write_shard(tmp_path / "frames", "s1/ball_lift", "s1", "ball", shard_values(1, 0))
    finish_store(tmp_path / "frames", hand.fingerprint, {"s1": hand.v_template}, ["ball"], {})
    meshes = str(tiny_dataset / OBJECT_MESHES)
    data = GraspDataModule(hand, str(tmp_path), Split("object", [], []), objects_dir=meshes, cache_dir=str(cache_dir))
    with pytest.raises(UserError, match=r"has 1 train frames.*leave some out of data\.split\.val"):
        data.setup()


def test_a_missing_data_set_is_an_error(hand, tmp_path):
    with pytest.raises(UserError, match="does not exist"):
        GraspDataModule(hand, str(Path(tmp_path) / "nowhere"), **SPLIT).setup()
