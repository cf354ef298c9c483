"""What is said of validation grasps is checked on grasps that are known: the true ones."""

import lightning as L
import pytest
import torch
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from PIL import Image

from grabnet.body.anatomy import FINGERS, Anatomy
from grabnet.cli.entry import compose, refusal
from grabnet.data.datamodule import GraspDataModule
from grabnet.data.splits import Split
from grabnet.losses.grasp import RefineNetLoss
from grabnet.training.modules import RefineNetTraining
from grabnet.training.monitoring import GraspMonitor
from grabnet.training.refine_inputs import RecordedPerturbed
from grabnet.visual.pictures import can_render

WEIGHTS = {"vertex": 1.0, "edge": 1.0, "hand_to_object": 1.0, "scale": 1.0}
WEIGHTS |= {"weight_exponent": 0.4, "contact_weights": "learned"}


@pytest.fixture(scope="module")
def data(tiny_dataset, hand, cache_dir) -> GraspDataModule:
    names = {"split": Split("object", ["can", "block"], ["ring"])}
    data = GraspDataModule(hand, str(tiny_dataset), **names, object_points=64, cache_dir=str(cache_dir))
    data.setup()
    return data


def unchanging(hand, contact: torch.Tensor, noise: float) -> RefineNetTraining:
    """A RefineNet whose corrections are none."""
    module = RefineNetTraining(
        hand,
        contact,
        iterations=1,
        width=8,
        n_hidden=8,
        dropout=0.3,
        source=RecordedPerturbed(noise, noise, noise),
        loss=lambda **given: RefineNetLoss(**given, **WEIGHTS),
        optimizer=lambda parameters: torch.optim.SGD(parameters),
        scheduler=lambda optimizer: None,
    )
    for layer in (module.network.pose, module.network.transl):
        torch.nn.init.zeros_(layer.weight)
    return module


def watched(data: GraspDataModule, module: RefineNetTraining, monitor: GraspMonitor) -> dict[str, float]:
    trainer = L.Trainer(
        accelerator="cpu",
        callbacks=[monitor],
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        use_distributed_sampler=False,
    )
    (metrics,) = trainer.validate(module, datamodule=data, verbose=False)
    return {name.removeprefix("val_grasps/"): value for name, value in metrics.items() if "grasps" in name}


def test_true_grasps_are_measured_as_they_are(data, hand, tmp_path):
    monitor = GraspMonitor(grasps=7, pictures=2, draw_every_n_epochs=1, folder=str(tmp_path), seed=0)
    found = watched(data, unchanging(hand, data.contact, 0.0), monitor)
    finger = Anatomy.of(hand).finger
    distances = data.assemble("val", torch.tensor([0, 16, 32, 48, 63, 79, 95])).distances
    touching = distances < 0.0045
    touched = [{FINGERS[f] for f in finger[row].tolist() if f >= 0} for row in touching]
    expected = {
        "max_penetration_mm": sum(max(0.0, -1000 * float(row.min())) for row in distances) / 7,
        "pinched": sum("thumb" in fingers and len(fingers) > 1 for fingers in touched) / 7,
        "contact_vertices": float(touching.sum()) / 7,
    }
    assert expected["max_penetration_mm"] > 5 and 0 < expected["pinched"] <= 1
    # Of lines that end at those vertices, none is in the object by less than its end.
    assert found.pop("through_mm") >= expected["max_penetration_mm"]
    assert found == pytest.approx(expected, rel=0.02)
    if can_render() is None:
        image = Image.open(tmp_path / "epoch_0000.png")
        assert image.width > 400 and len(image.getcolors(1 << 24)) > 100


def test_random_numbers_of_training_go_on_as_if_nobody_had_looked(data, hand, tmp_path):
    module = unchanging(hand, data.contact, 0.1)
    found, states = [], []
    for grasps, seed in ((5, 0), (9, 0), (5, 0), (5, 1)):
        found.append(watched(data, module, GraspMonitor(grasps, 0, 1, str(tmp_path), seed)))
        states.append(torch.random.get_rng_state())
    assert all(torch.equal(state, states[0]) for state in states)
    assert found[0] == found[2] != found[3]


def test_wandb_is_told_how_to_be_had(monkeypatch):
    monkeypatch.setattr("lightning.pytorch.loggers.wandb._WANDB_AVAILABLE", False)
    with pytest.raises(InstantiationException) as caught:
        instantiate(compose("train", ["logger=wandb", "run_dir=nowhere"]).logger.wandb)
    assert str(refusal(caught.value)) == "logger=wandb needs wandb: pip install -e '.[wandb]'."


def test_pictures_wait_their_epochs(data, hand, tmp_path):
    assert watched(data, unchanging(hand, data.contact, 0.0), GraspMonitor(5, 1, 2, str(tmp_path), 0))
    assert not list(tmp_path.iterdir())
