"""The frames store: what is written comes back, and damage is told in a sentence."""

import json

import pytest
import torch

from grabnet.data.frames import FramesStore, finish_store, write_shard
from grabnet.errors import UserError
from grabnet.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from grabnet.io.files import write_json

HAND = 64 * "0"


def shard_values(n: int, seed: int) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    widths = {"global_orient": 3, "hand_pose": 45, "transl": 3, "object_orient": 3}
    values = {name: torch.randn(n, width, generator=generator) for name, width in widths.items()}
    return values | {"frame": 4 * torch.arange(n)}


@pytest.fixture
def store(tmp_path):
    for k, (sequence, subject, thing) in enumerate(
        [("s1/mug_lift_1", "s1", "mug"), ("s1/cup_pass_1", "s1", "cup"), ("s2/mug_use_1", "s2", "mug")]
    ):
        write_shard(tmp_path, sequence, subject, thing, shard_values(3 + k, k), intent="lift")
    finish_store(tmp_path, HAND, {"s1": torch.zeros(5, 3), "s2": torch.ones(5, 3)}, ["mug", "cup"], {"made": "here"})
    return tmp_path


def test_frames_come_back_with_their_names(store):
    loaded = FramesStore.load(store)
    assert (loaded.subjects, loaded.objects) == (["s1", "s2"], ["cup", "mug"])
    assert loaded.sequences == ["s1/cup_pass_1", "s1/mug_lift_1", "s2/mug_use_1"]
    assert loaded.card["provenance"] == {"made": "here"}
    frames = loaded.frames
    assert len(frames) == 12
    chosen = frames.select(frames.sequence == loaded.sequences.index("s2/mug_use_1"))
    for name, value in shard_values(5, 2).items():
        torch.testing.assert_close(getattr(chosen, name), value)
    assert {loaded.subjects[i] for i in chosen.subject} == {"s2"}
    assert {loaded.objects[i] for i in chosen.object} == {"mug"}


def test_a_store_takes_under_400_bytes_a_frame(tmp_path):
    write_shard(tmp_path, "s1/mug_lift_1", "s1", "mug", shard_values(1000, 0))
    assert sum(p.stat().st_size for p in tmp_path.rglob("*.safetensors")) < 400 * 1000


def test_noisy_hands_fit_in_as_well_and_come_back_as_near_as_they_must(tmp_path):
    """Rotations of up to half a turn, near which the two ways to write one down lie far apart."""
    values, n = shard_values(1000, 0), 1000
    axes = torch.nn.functional.normalize(torch.randn(n, 16, 3), dim=2)
    true = axes * (torch.pi - 0.2 * torch.rand(n, 16, 1))
    noisy = matrix_to_axis_angle(axis_angle_to_matrix(0.1 * torch.randn(n, 16, 3)) @ axis_angle_to_matrix(true))
    values |= {"global_orient": true[:, 0], "hand_pose": true[:, 1:].flatten(1)}
    values["noisy"] = torch.cat([noisy.flatten(1), values["transl"] + 0.01 * torch.randn(n, 3)], 1)
    write_shard(tmp_path, "s1/mug_lift_1", "s1", "mug", values)
    assert sum(p.stat().st_size for p in tmp_path.rglob("*.safetensors")) < 400 * n
    finish_store(tmp_path, HAND, {"s1": torch.zeros(5, 3)}, ["mug"], {})
    hand = FramesStore.load(tmp_path).frames.noisy_hand()
    expected = axis_angle_to_matrix(noisy)
    for found, wanted in ((hand.global_orient, expected[:, 0]), (hand.hand_pose, expected[:, 1:])):
        torch.testing.assert_close(found, wanted, atol=1e-3, rtol=0)
    torch.testing.assert_close(hand.transl, values["noisy"][:, 48:], atol=3e-5, rtol=0)


def test_a_wrong_shape_is_refused_before_anything_is_written(tmp_path):
    values = shard_values(4, 0) | {"transl": torch.zeros(4, 2)}
    with pytest.raises(ValueError, match=r"transl has shape \(4, 2\)"):
        write_shard(tmp_path, "s1/mug_lift_1", "s1", "mug", values)
    assert not list(tmp_path.rglob("*.safetensors"))


def test_an_unfinished_store_is_not_read(tmp_path):
    write_shard(tmp_path, "s1/mug_lift_1", "s1", "mug", shard_values(4, 0))
    with pytest.raises(UserError, match=r"store\.json does not exist"):
        FramesStore.load(tmp_path)


@pytest.mark.parametrize("name", ["shards/s1/mug_lift_1.safetensors", "subjects.safetensors", "store.json"])
def test_a_truncated_file_is_named(store, name):
    file = store / name
    file.write_bytes(file.read_bytes()[:-50])
    with pytest.raises(UserError, match=f"{name} is damaged"):
        FramesStore.load(store)


def test_a_card_without_names_is_damaged(store):
    card = json.loads((store / "store.json").read_text())
    del card["subjects"]
    write_json(store / "store.json", card)
    with pytest.raises(UserError, match=r"store\.json is damaged \(it has no subjects\)"):
        FramesStore.load(store)


def test_an_empty_store_is_told(tmp_path):
    finish_store(tmp_path, HAND, {"s1": torch.zeros(5, 3)}, ["mug"], {})
    with pytest.raises(UserError, match=r"The frames store .* is empty"):
        FramesStore.load(tmp_path)
