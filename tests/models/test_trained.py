import os

import pytest
import torch
from safetensors.torch import save

from grabnet.errors import UserError
from grabnet.generation.grabber import Grabber
from grabnet.io.files import sha256
from grabnet.models.trained import OPEN_GRABBER, check_hand, find_network, find_pair
from grabnet.models.weights import FILE_NAME, save_network


@pytest.fixture
def runs(tmp_path, grabber):
    for k, (name, network) in enumerate(
        [("coarse/old", grabber.coarsenet), ("coarse/new", grabber.coarsenet), ("fine", grabber.refinenet)]
    ):
        path = tmp_path / "runs" / name / "model.safetensors"
        save_network(path, network, {"hand_sha256": sha256(grabber.hand.v_template.numpy())})
        os.utime(path, (1000 + k, 1000 + k))
    (tmp_path / "runs" / "broken").mkdir()
    (tmp_path / "runs" / "broken" / "model.safetensors").write_bytes(b"not weights at all")
    return tmp_path / "runs"


def test_the_newest_of_its_kind_is_taken(runs):
    assert find_network("CoarseNet", None, runs) == runs / "coarse" / "new" / "model.safetensors"
    assert find_network("RefineNet", None, runs) == runs / "fine" / "model.safetensors"


def test_a_named_run_is_taken(runs):
    assert find_network("CoarseNet", runs / "coarse" / "old", runs) == runs / "coarse" / "old" / "model.safetensors"
    file = runs / "fine" / "model.safetensors"
    assert find_network("RefineNet", file, runs) == file


def test_training_starts_from_none_that_went_on_from_its_kind(runs, grabber):
    went_on, guessed_from = runs / "both/coarsenet/model.safetensors", runs / "both/refinenet/model.safetensors"
    for path, network in ((went_on, grabber.coarsenet), (guessed_from, grabber.refinenet)):
        save_network(path, network, {"trained_from": {"CoarseNet": {}}})
    assert find_network("CoarseNet", None, runs) == runs / "coarse" / "new" / "model.safetensors"
    assert find_network("RefineNet", None, runs) == guessed_from
    assert find_network("CoarseNet", went_on, runs) == went_on
    assert find_pair(runs=runs) == (went_on, guessed_from)


def test_a_missing_network_is_told_with_what_exists(runs, tmp_path):
    (runs / "fine" / "model.safetensors").unlink()
    with pytest.raises(UserError) as told:
        find_network("RefineNet", None, runs)
    for part in ("RefineNet", "coarse/new (CoarseNet)", "make demo", "model=refinenet", "refinenet="):
        assert part in str(told.value)
    with pytest.raises(UserError, match="no trained network"):
        find_network("CoarseNet", None, tmp_path / "nowhere")
    with pytest.raises(UserError, match="does not exist"):
        find_network("CoarseNet", runs / "mistyped", runs)


def test_a_pair_is_the_newest_or_the_shipped_one(runs, tmp_path):
    coarse, fine, old = (runs / name / "model.safetensors" for name in ("coarse/new", "fine", "coarse/old"))
    assert find_pair(runs=runs) == (coarse, fine)
    assert find_pair(coarsenet=runs / "coarse" / "old", runs=runs) == (old, fine)
    shipped = tuple(OPEN_GRABBER / name / "model.safetensors" for name in ("coarsenet", "refinenet"))
    assert find_pair(runs=tmp_path / "nowhere") == shipped
    assert find_pair(coarsenet=coarse, runs=tmp_path / "nowhere") == (coarse, shipped[1])
    fine.unlink()
    assert find_pair(runs=runs) == shipped  # a pair trained together, not half of one


def test_a_file_of_others_is_told(grabber, tmp_path):
    for name, network in (("coarsenet", grabber.coarsenet), ("refinenet", grabber.refinenet)):
        save_network(tmp_path / name / FILE_NAME, network, {})
    (tmp_path / "coarsenet" / FILE_NAME).write_bytes(save({"weight": torch.zeros(2)}))
    with pytest.raises(UserError, match=r"model\.safetensors holds no grabnet network, where CoarseNet is wanted"):
        Grabber.from_pretrained(tmp_path)


def test_another_hand_is_refused(runs, grabber, tmp_path):
    path = find_network("CoarseNet", None, runs)
    check_hand(path, grabber.hand)
    save_network(path, grabber.coarsenet, {"hand_sha256": "0" * 64})
    with pytest.raises(UserError, match="another hand"):
        check_hand(path, grabber.hand)
