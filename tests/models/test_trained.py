import json
import os
import re
import resource

import pytest
import torch
from safetensors.torch import load, save

from grabnet.cli.entry import compose
from grabnet.commands.ship_weights import ship
from grabnet.errors import UserError
from grabnet.generation.grabber import Grabber
from grabnet.io.files import sha256
from grabnet.io.tensors import read_facts
from grabnet.models.trained import OPEN_GRABBER, find_model, find_network, load_model
from grabnet.models.weights import FILE_NAME, check_hand, load_network, save_network


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


def _rewritten(path, change) -> None:
    """A weights file with other sizes or tensors, as whole as before."""
    content = path.read_bytes()
    header = read_facts(content)
    tensors = load(content)
    change(header, tensors)
    path.write_bytes(save(tensors, header))


def _sizes(**values):
    return lambda header, tensors: header.update(sizes=json.dumps(json.loads(header["sizes"]) | values))


_NO_SIZES = (None, [], "32", 0, -1, 2.5, float("nan"), 10**12, 10**6, True)
HOSTILE = {
    **{f"width {value}": _sizes(width=value) for value in _NO_SIZES},
    "n_hidden and width": _sizes(width=10**5, n_hidden=10**5),
    "latent_dim": _sizes(latent_dim=10**9),
    "unknown size": _sizes(depth=3),
    "sizes": lambda header, tensors: header.update(sizes="[" * 10_000),
    "no sizes": lambda header, tensors: header.pop("sizes"),
    "conventions": lambda header, tensors: header.update(conventions='{"points_in_use": 1000000000000}'),
    "conventions of another kind": lambda header, tensors: header.update(conventions='{"centre": ["box"]}'),
    "provenance": lambda header, tensors: header.update(provenance="[]"),
    "not a number": lambda header, tensors: tensors["mean.weight"].fill_(float("nan")),
    "infinite": lambda header, tensors: tensors["encoder_norm.running_var"].fill_(float("inf")),
    "whole numbers": lambda header, tensors: tensors.update({"mean.bias": tensors["mean.bias"].long()[:1]}),
    "another shape": lambda header, tensors: tensors.update({"mean.weight": tensors["mean.weight"][:1].clone()}),
    "no rows": lambda header, tensors: tensors.update({"bps.basis": torch.zeros(10**12, 0)}),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_weights_end_in_a_sentence_and_take_no_memory(name, grabber, tmp_path):
    path = tmp_path / FILE_NAME
    save_network(path, grabber.generator.coarsenet, {})
    _rewritten(path, HOSTILE[name])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(UserError, match=re.escape(str(tmp_path))):
        load_network(path, grabber.hand)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # kB


@pytest.mark.parametrize("value", [0, 10**12, 2.5, "3", None])
def test_iterations_of_a_refinenet_are_a_few(value, grabber, tmp_path):
    save_network(tmp_path / FILE_NAME, grabber.generator.refinenet, {})
    _rewritten(tmp_path / FILE_NAME, _sizes(iterations=value))
    with pytest.raises(UserError, match=r"iterations is|sizes"):
        load_network(tmp_path / FILE_NAME, grabber.hand)
