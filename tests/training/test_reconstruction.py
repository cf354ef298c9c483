"""Errors of reconstruction by both protocols, against hands reconstructed and measured one by one."""

import lightning as L
import numpy as np
import pytest
import torch
from hydra.utils import instantiate

from grabnet.cli.entry import compose
from tests.tiny import tiny_overrides


@pytest.fixture(scope="module")
def tested(hand, tiny_dataset, cache_dir, tmp_path_factory):
    """A CoarseNet that has learned nothing, its data with subjects of different shapes, and its test's figures."""
    cfg = compose("train", tiny_overrides(tiny_dataset, None, cache_dir))
    data = instantiate(cfg.data, hand=hand)
    data.setup()
    torch.manual_seed(0)
    module = instantiate(cfg.model, hand=hand, contact=data.contact)
    with torch.no_grad():
        module.network.transl.weight.mul_(5)  # so that a sample is another hand than the mean
    folder = tmp_path_factory.mktemp("tested")
    trainer = L.Trainer(logger=False, enable_progress_bar=False, accelerator="cpu", default_root_dir=folder)
    trainer.test(module, datamodule=data, verbose=False)
    return module.eval(), data, {name: float(value) for name, value in trainer.callback_metrics.items()}


@pytest.mark.parametrize("split", ["train", "val", "test"])
def test_both_protocols_are_what_they_are_named(tested, hand, split):
    module, data, figures = tested
    found = {name: [] for name in ("v2v", "v2v_mae", "published_v2v", "published_v2v_mae")}
    subjects = data.store.v_template
    assert (subjects - hand.v_template).abs().max() > 1e-3
    frames = data.frames(split)
    for name, index, seed in data.loader(split):
        torch.manual_seed(seed)  # as a batch's noise is seeded
        noise = torch.randn(len(index), module.network.latent_dim)
        batch = data.assemble(name, index)
        for k, number in enumerate(index):
            objects = batch.objects.select(slice(k, k + 1))
            bps = objects.atlas.basis_distances(
                module.network.bps.basis, objects.index, objects.rotations, objects.centres
            )
            true = frames.select(number.view(1)).hand()
            with torch.no_grad():
                posterior = module.network.encode(bps, true.global_orient, true.transl)
                guess = module.network.decode(posterior.mean, bps)
                sample = module.network.decode(posterior.mean + posterior.stddev * noise[k], bps)
            own = subjects[frames.subject[number]]
            for protocol, of_hand, rest in (("", guess, own), ("published_", sample, hand.v_template)):
                difference = (hand(of_hand, rest).vertices - hand(true, rest).vertices)[0].double().numpy() * 1000
                found[f"{protocol}v2v"].append(np.linalg.norm(difference, axis=1).mean())
                found[f"{protocol}v2v_mae"].append(np.abs(difference).mean())
    for name, values in found.items():
        assert figures[f"test/{split}/{name}"] == pytest.approx(np.mean(values), rel=1e-4), name
    assert figures[f"test/{split}/published_v2v"] != pytest.approx(figures[f"test/{split}/v2v"], rel=1e-3)
