import os

import pytest
import torch
from safetensors.torch import save

from grabnet.cli.entry import compose
from grabnet.commands.ship_weights import ship
from grabnet.errors import UserError
from grabnet.generation.grabber import Grabber
from grabnet.io.files import sha256
from grabnet.models.trained import OPEN_GRABBER, find_model, find_network, load_model
from grabnet.models.weights import FILE_NAME, check_hand, save_network


@pytest.fixture
def runs(tmp_path, grabber):
    for k, (name, network) in enumerate(
        [
            ("coarse/old", grabber.generator.coarsenet),
            ("coarse/new", grabber.generator.coarsenet),
            ("fine", grabber.generator.refinenet),
        ]
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
    for path, network in ((went_on, grabber.generator.coarsenet), (guessed_from, grabber.generator.refinenet)):
        save_network(path, network, {"trained_from": {"CoarseNet": {}}})
    assert find_network("CoarseNet", None, runs) == runs / "coarse" / "new" / "model.safetensors"
    assert find_network("RefineNet", None, runs) == guessed_from
    assert find_network("CoarseNet", went_on, runs) == went_on
    assert find_model("newest", runs) == {"CoarseNet": went_on, "RefineNet": guessed_from}


def test_trials_take_no_place(runs, grabber):
    """debug=default writes below runs/, too."""
    tried = runs / "tried" / FILE_NAME
    save_network(tried, grabber.generator.coarsenet, {"config": {"trial": True}})
    newest = runs / "coarse" / "new" / FILE_NAME
    assert find_network("CoarseNet", None, runs) == find_model("newest", runs)["CoarseNet"] == newest
    assert find_network("CoarseNet", tried, runs) == tried
    with pytest.raises(UserError, match=r"tried/model\.safetensors was only tried out"):
        ship(tried, runs / "shipped")
    assert all(compose("train", [f"debug={name}"]).trial for name in ("default", "overfit"))
    assert not compose("train", []).trial


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


def test_the_newest_model_is_the_newest_of_each_network(runs, tmp_path):
    coarse, fine = (runs / name / FILE_NAME for name in ("coarse/new", "fine"))
    assert find_model("newest", runs) == {"CoarseNet": coarse, "RefineNet": fine}
    fine.unlink()
    assert find_model("newest", runs) == {"CoarseNet": coarse}
    with pytest.raises(UserError, match=r"no network that makes grasps below .*nowhere.* use model=open"):
        find_model("newest", tmp_path / "nowhere")


def test_the_shipped_model_is_used_whatever_was_trained(runs, monkeypatch):
    """A debug run does not take its place."""
    monkeypatch.chdir(runs.parent)
    shipped = {kind: OPEN_GRABBER / kind.lower() / FILE_NAME for kind in ("CoarseNet", "RefineNet")}
    assert find_model() == find_model("open") == shipped


def test_a_model_is_named_by_files_and_folders(runs, grabber, tmp_path):
    old, fine = (runs / name / FILE_NAME for name in ("coarse/old", "fine"))
    assert find_model(runs / "coarse" / "old") == find_model(str(old)) == {"CoarseNet": old}
    assert find_model([old, runs / "fine"]) == {"CoarseNet": old, "RefineNet": fine}
    for name in ("coarsenet", "refinenet"):
        save_network(tmp_path / "both" / name / FILE_NAME, getattr(grabber.generator, name), {})
    files = find_model(tmp_path / "both")
    assert files == {k: tmp_path / "both" / k.lower() / FILE_NAME for k in ("CoarseNet", "RefineNet")}
    assert load_model(files, grabber.hand).refinenet is not None
    assert load_model(files, grabber.hand, refine=False).refinenet is None


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["fine"], "no network that makes grasps, only RefineNet"),
        (["coarse/old", "coarse/new"], "both hold a CoarseNet"),
        (["broken"], "holds no grabnet network"),
        (["coarse"], r"coarse holds new, old"),
    ],
)
def test_what_is_no_model_is_refused(runs, names, said):
    with pytest.raises(UserError, match=said):
        find_model([runs / name for name in names])


def test_a_file_of_others_is_told(grabber, tmp_path):
    for name, network in grabber.generator.named_children():
        save_network(tmp_path / name / FILE_NAME, network, {})
    (tmp_path / "coarsenet" / FILE_NAME).write_bytes(save({"weight": torch.zeros(2)}))
    with pytest.raises(UserError, match=r"model\.safetensors holds no grabnet network; it must hold"):
        Grabber.from_pretrained(tmp_path)


def test_another_hand_is_refused(runs, grabber, tmp_path):
    path = find_network("CoarseNet", None, runs)
    check_hand(path, grabber.hand)
    save_network(path, grabber.generator.coarsenet, {"hand_sha256": "0" * 64})
    with pytest.raises(UserError, match="another hand"):
        check_hand(path, grabber.hand)
