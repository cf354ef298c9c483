"""Frames are held out by the names of objects, subjects or sequences."""

import pytest
import torch

from grabnet.cli.entry import compose
from grabnet.data.frames import FramesStore
from grabnet.data.splits import Split
from grabnet.errors import UserError
from tests.tiny import tiny_overrides


@pytest.mark.parametrize(
    ("split", "expected"),
    [
        (Split("object", ["mug"], ["cup"]), "val"),
        (Split("object", ["cup"], ["mug"]), "test"),
        (Split("object", ["s1"], ["s1/mug_use_1"]), "train"),
        (Split("subject", ["s1"], ["mug"]), "val"),
        (Split("sequence", [], ["s1/mug_use_1"]), "test"),
        (Split("sequence", ["s1/mug_use_2"], []), "train"),
    ],
)
def test_a_frame_is_where_its_name_is_and_its_mirror_image_too(split, expected):
    names = {"object": "mug", "subject": "s1", "sequence": "s1/mug_use_1"}
    assert split.of(**names) == expected
    assert split.of(**{aspect: f"{name}_mirrored" for aspect, name in names.items()}) == expected


@pytest.mark.parametrize("by", ["object", "subject", "sequence"])
def test_every_frame_of_a_store_is_in_one_part(tiny_dataset, by):
    store = FramesStore.load(tiny_dataset / "frames")
    held_out = {"object": "can", "subject": "s2", "sequence": "s1/ring_lift_1"}[by]
    split = Split(by, [], [held_out])
    members = {name: split.members(store, name) for name in ("train", "val", "test")}
    assert torch.cat([*members.values()]).sort().values.tolist() == list(range(len(store.frames)))
    test = store.part(members["test"])
    assert {getattr(store, f"{by}s")[n] for n in getattr(test.frames, by)} == {held_out}
    assert len(members["test"]) == {"object": 48, "subject": 96, "sequence": 24}[by]
    assert test.shown_objects == {"object": ["can"], "subject": store.objects, "sequence": ["ring"]}[by]


def test_mistakes_are_refused():
    with pytest.raises(UserError, match=r"split\.by is 'person'; it can be object, subject, sequence\."):
        Split("person", [], [])
    with pytest.raises(UserError, match=r"split\.val and split\.test both name mug"):
        Split("object", ["cup", "mug"], ["mug"])


def test_it_is_a_choice_of_training_and_of_preprocessing(tmp_path):
    values = [o for o in tiny_overrides(tmp_path, tmp_path, tmp_path) if "split" not in o]
    chosen = compose("train", [*values, "data/split=by_subject"]).data.split
    assert (chosen.by, list(chosen.test)) == ("subject", ["s10"])
    assert compose("preprocess/preprocess", ["split=by_subject", "split.val=[s1]"]).split == {**chosen, "val": ["s1"]}
    assert compose("evaluate", ["split=val"]).data.split == compose("preprocess/preprocess", []).split
    for command, group in (("train", "data/split"), ("preprocess/preprocess", "split")):
        with pytest.raises(UserError, match="can be by_subject, paper"):
            compose(command, [f"{group}=by_person"])
