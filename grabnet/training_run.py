"""One training run from config to weights: what `train.py` does."""

from __future__ import annotations

import errno
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import lightning as L
import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from grabnet.data.datamodule import GraspDataModule
from grabnet.errors import UserError
from grabnet.files import replacing, sha256, write_json
from grabnet.history import History, best_epoch
from grabnet.models.checkpoints import BEST, AtomicCheckpointIO, newest_whole, read_checkpoint
from grabnet.models.training import GraspTraining
from grabnet.models.weights import FILE_NAME, save_network
from grabnet.provenance import provenance
from grabnet.sweeps.runs import METRICS

log = logging.getLogger(__name__)

# What a disk says that takes no more.
DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES}


def train(cfg: DictConfig) -> dict[str, float]:
    """Train, test and save.

    The run folder `cfg.run_dir` gets config.yaml, provenance.json, logs/, history.json, checkpoints/,
    model.safetensors and, last, metrics.json (of the best epoch by `cfg.objective`, and test errors of its weights):
    where that exists, the run is complete.

    Returns:
        the metrics.

    Raises:
        UserError: the training diverged, the disk takes no more, or no checkpoint of a begun run can be read.
    """
    run_dir = Path(cfg.run_dir)
    with _disk_errors_told(run_dir):
        return _train(cfg, run_dir)


def _train(cfg: DictConfig, run_dir: Path) -> dict[str, float]:
    _quiet()
    # Said explicitly, so that MKL does not choose another number of threads, and order of sums, from call to call.
    torch.set_num_threads(torch.get_num_threads())
    L.seed_everything(cfg.seed, verbose=False)
    with replacing(run_dir / "config.yaml") as temporary:
        OmegaConf.save(cfg, temporary, resolve=True)

    hand = instantiate(cfg.hand_model)
    data: GraspDataModule = instantiate(cfg.data, hand=hand)
    data.prepare_data()
    data.setup()
    module: GraspTraining = instantiate(cfg.model, hand=hand, contact=data.contact)
    history = History(cfg.objective)
    trainer: L.Trainer = instantiate(
        cfg.trainer,
        default_root_dir=run_dir,
        callbacks=[history] + [instantiate(c) for c in cfg.callbacks.values() if c is not None],
        logger=[instantiate(c) for c in cfg.logger.values() if c is not None],
        plugins=[AtomicCheckpointIO()],
    )
    record = provenance(seed=cfg.seed, data=data.record(), hand_sha256=sha256(hand.v_template.numpy()))
    write_json(run_dir / "provenance.json", record)

    checkpoints = run_dir / "checkpoints"
    resumed = newest_whole(checkpoints) if cfg.resume else None
    if resumed:
        log.info("Going on from %s.", resumed)
    trainer.fit(module, datamodule=data, ckpt_path=resumed)
    metrics = best_epoch(history.epochs, cfg.objective)
    if metrics is None:
        raise UserError(f"{run_dir} diverged: {cfg.objective} was never finite; lower model.optimizer.lr.")
    if (checkpoints / BEST).exists():
        module.load_state_dict(read_checkpoint(checkpoints / BEST)["state_dict"])
    if cfg.test:
        trainer.test(module, datamodule=data, verbose=False)
        metrics = metrics | {name: float(value) for name, value in trainer.callback_metrics.items()}
    if trainer.is_global_zero:
        config: Any = OmegaConf.to_container(cfg, resolve=True)
        for folder, network in module.networks.items():
            save_network(run_dir / folder / FILE_NAME, network, record | {"config": config, "metrics": metrics})
        write_json(run_dir / METRICS, metrics)
    log.info("Weights, metrics and logs are in %s.", run_dir)
    return metrics


@contextmanager
def _disk_errors_told(run_dir: Path) -> Iterator[None]:
    """Turn what a full or read-only disk raises into the one sentence that its owner needs."""
    try:
        yield
    except OSError as error:
        elsewhere = error.filename is not None and not Path(error.filename).is_relative_to(run_dir)
        if error.errno not in DISK_ERRORS or elsewhere:
            raise
        good = newest_whole(run_dir / "checkpoints")
        remains = f"{good} is whole, and the same command goes on from it" if good else "no checkpoint was written yet"
        raise UserError(
            f"{run_dir} cannot be written to ({error.strerror}): make room, or choose another run_dir; {remains}."
        ) from None


def _quiet() -> None:
    """Drop Lightning's advice that does not apply (batches are made on the device, no worker could help) and what it
    says of its own use of torch."""
    warnings.filterwarnings("ignore", message=".*LeafSpec.*is deprecated.*")
    warnings.filterwarnings("ignore", message=".*does not have many workers.*")
    warnings.filterwarnings("ignore", message=".*Checkpoint directory .* exists and is not empty.*")
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
