"""One training run from config to weights: what `train.py` does."""

from __future__ import annotations

import logging
import warnings
from pathlib import Path
from typing import Any

import lightning as L
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from grabnet.data.datamodule import GraspDataModule
from grabnet.files import replacing, sha256, write_json
from grabnet.models.checkpoints import AtomicCheckpointIO, read_checkpoint
from grabnet.models.training import GraspTraining
from grabnet.models.weights import FILE_NAME, save_network
from grabnet.provenance import provenance

log = logging.getLogger(__name__)


def train(cfg: DictConfig) -> dict[str, float]:
    """Train, test and save.

    The run folder `cfg.run_dir` gets config.yaml, provenance.json, logs/, checkpoints/, metrics.json (test errors of
    the best weights) and, last, model.safetensors: where that exists, the run is complete.

    Returns:
        the metrics.
    """
    run_dir = Path(cfg.run_dir)
    _quiet()
    L.seed_everything(cfg.seed, verbose=False)
    with replacing(run_dir / "config.yaml") as temporary:
        OmegaConf.save(cfg, temporary, resolve=True)

    hand = instantiate(cfg.hand_model)
    data: GraspDataModule = instantiate(cfg.data, hand=hand)
    data.prepare_data()
    data.setup()
    module: GraspTraining = instantiate(cfg.model, hand=hand, contact=data.contact)
    trainer: L.Trainer = instantiate(
        cfg.trainer,
        default_root_dir=run_dir,
        callbacks=[instantiate(c) for c in cfg.callbacks.values() if c is not None],
        logger=[instantiate(c) for c in cfg.logger.values() if c is not None],
        plugins=[AtomicCheckpointIO()],
    )
    record = provenance(seed=cfg.seed, data=data.record(), hand_sha256=sha256(hand.v_template.numpy()))
    write_json(run_dir / "provenance.json", record)

    last, best = run_dir / "checkpoints" / "last.ckpt", run_dir / "checkpoints" / "best.ckpt"
    resumed = last if cfg.resume and last.exists() else None
    if resumed:
        log.info("Going on from %s.", resumed)
    trainer.fit(module, datamodule=data, ckpt_path=resumed)
    if best.exists():
        module.load_state_dict(read_checkpoint(best)["state_dict"])
    metrics = _metrics(trainer)
    if cfg.test:
        trainer.test(module, datamodule=data, verbose=False)
        metrics |= _metrics(trainer)
    write_json(run_dir / "metrics.json", metrics)
    if trainer.is_global_zero:
        config: Any = OmegaConf.to_container(cfg, resolve=True)
        for folder, network in module.networks.items():
            save_network(run_dir / folder / FILE_NAME, network, record | {"config": config, "metrics": metrics})
    log.info("Weights, metrics and logs are in %s.", run_dir)
    return metrics


def _metrics(trainer: L.Trainer) -> dict[str, float]:
    return {name: float(value) for name, value in trainer.callback_metrics.items()}


def _quiet() -> None:
    """Drop Lightning's advice that does not apply (batches are made on the device, no worker could help) and what it
    says of its own use of torch."""
    warnings.filterwarnings("ignore", message=".*LeafSpec.*is deprecated.*")
    warnings.filterwarnings("ignore", message=".*does not have many workers.*")
    warnings.filterwarnings("ignore", message=".*Checkpoint directory .* exists and is not empty.*")
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
