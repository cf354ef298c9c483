"""One training run from config to weights: what `train.py` does.

`python -m grabnet.training.run <config.yaml>` takes part in a run that another process has started.
"""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import lightning as L
import torch
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from lightning.fabric.utilities.exceptions import MisconfigurationException
from omegaconf import DictConfig, OmegaConf

from grabnet.cli.ends import Stopped, in_sentences
from grabnet.data.datamodule import GraspDataModule
from grabnet.errors import UserError, printable
from grabnet.io.files import naming, replacing, write_json
from grabnet.io.litter import clear_litter
from grabnet.io.locks import alone_in
from grabnet.io.provenance import provenance
from grabnet.io.recipes import refuse_other
from grabnet.io.state import Kind, read_config, read_json
from grabnet.models.weights import FILE_NAME, save_network
from grabnet.training.acceleration import compile_blocks, denormals_flushed, set_matmul_precision
from grabnet.training.checkpoints import BEST, AtomicCheckpointIO, drop_damaged, newest_whole, read_checkpoint
from grabnet.training.ending import METRICS, RunPruned
from grabnet.training.history import History, best_epoch
from grabnet.training.modules import GraspTraining
from grabnet.training.processes import OwnProcesses, started_from_outside, together
from grabnet.training.rehearsal import rehearse
from grabnet.training.stopping import EndsAtOnce, ObjectiveMeasured, StopStaysStopped, ended_by

log = logging.getLogger(__name__)

PROVENANCE = "provenance.json"
_PROVENANCE: Kind = {"made": str, "versions": {str: object}, "machine": str, "commit": (str, None)}
_PROVENANCE |= {"trained_from": {str: object}, "earlier?": [{str: object}]}
# What a run is started with and cannot change when it goes on. How long it takes and what it tells can.
_FIXED = ("hand_model", "data", "model", "seed", "objective")


def train(cfg: DictConfig) -> dict[str, float]:
    """Train, test and save.

    The run folder `cfg.run_dir` gets config.yaml, provenance.json (with `ended_by`), logs/, history.json, checkpoints/,
    model.safetensors and, last, metrics.json (of the best epoch by `cfg.objective`, and test errors of its weights):
    where that exists, the run is complete. Where the trainer has several devices each gets a process of its own, of
    which only the first one writes.

    Returns:
        the metrics.

    Raises:
        UserError: the training diverged or had no time, another one writes to the run folder, a started run is to go on
            with other settings or has no checkpoint or record that can be read, or the trainer cannot be had or run as
            configured.
    """
    run_dir = Path(cfg.run_dir)
    try:
        with _whole_checkpoint_said(run_dir), denormals_flushed():
            return _train(cfg, run_dir)
    except MisconfigurationException as error:  # such as a callback without the logger that it needs
        raise UserError(f"The trainer cannot run as configured: {' '.join(str(error).split())}") from None


def _train(cfg: DictConfig, run_dir: Path) -> dict[str, float]:
    _quiet()
    set_matmul_precision(cfg.matmul_precision)
    # Said explicitly, so that MKL does not choose another number of threads, and order of sums, from call to call.
    torch.set_num_threads(torch.get_num_threads())
    data: GraspDataModule = instantiate(cfg.data, hand=instantiate(cfg.hand_model))
    history, resumed = History(), None
    trainer = _trainer(cfg, history)
    with ExitStack() as stack:
        if trainer.is_global_zero:
            stack.enter_context(alone_in(run_dir, "run_dir"))
            resumed = _begin(cfg, run_dir, data)
        log.disabled = not trainer.is_global_zero
        stack.enter_context(together(trainer, __spec__.name, run_dir / "config.yaml"))
        data.setup()
        return _fit(cfg, run_dir, data, trainer, history, trainer.strategy.broadcast(resumed))


def _begin(cfg: DictConfig, run_dir: Path, data: GraspDataModule) -> Path | None:
    """Write what the other processes read; return the checkpoint that the run goes on from, if any."""
    clear_litter(run_dir, "*.*", "checkpoints/*.*", "*/*.safetensors")
    if resumed := newest_whole(run_dir / "checkpoints") if cfg.resume else None:
        _refuse_other_settings(run_dir / "config.yaml", cfg)
        drop_damaged(resumed)
    with replacing(run_dir / "config.yaml") as temporary:
        OmegaConf.save(cfg, temporary, resolve=True)
    data.prepare_data()
    data.setup()
    return resumed


def _fit(
    cfg: DictConfig, run_dir: Path, data: GraspDataModule, trainer: L.Trainer, history: History, resumed: Path | None
) -> dict[str, float]:
    """Each process's part, once the data is there, from the checkpoint `resumed` where there is one."""
    L.seed_everything(cfg.seed, verbose=False)
    module: GraspTraining = instantiate(cfg.model, hand=data.hand, contact=data.contact)
    module.adopt(data.conventions)
    rehearse(module, data)
    if cfg.compile:
        compile_blocks(module.network)
    if trainer.is_global_zero:
        record = provenance(
            seed=cfg.seed,
            tags=list(cfg.tags),
            data=data.record(),
            hand_sha256=data.hand.fingerprint,
            trained_from=module.trained_from,
        )
        if resumed:
            record |= _earlier(run_dir / PROVENANCE)
        write_json(run_dir / PROVENANCE, record)
    if resumed:
        log.info("Going on from %s.", printable(str(resumed)))
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    for logger in trainer.loggers:
        logger.log_hyperparams(config)
    trainer.fit(module, datamodule=data, ckpt_path=resumed)
    ended = ended_by(trainer)
    metrics = best_epoch(history.epochs, cfg.objective)
    if not any(cfg.objective in epoch for epoch in history.epochs):
        raise UserError(f"{run_dir} ended before its first epoch did: raise trainer.max_epochs or trainer.max_time.")
    if ended == "max_time":
        log.warning(
            "trainer.max_time=%s ended the training in epoch %d of %s.",
            cfg.trainer.max_time,
            trainer.current_epoch,  # which counts the one that was cut
            trainer.max_epochs,
        )
    if metrics is None:
        raise UserError(f"{run_dir} diverged: {cfg.objective} was never finite; lower model.optimizer.lr.")
    if (best := run_dir / "checkpoints" / BEST).exists():
        module.load_state_dict(read_checkpoint(best)["state_dict"])
    if cfg.test:
        trainer.test(module, datamodule=data, verbose=False)
        metrics = metrics | {name: float(value) for name, value in trainer.callback_metrics.items()}
    if trainer.is_global_zero:
        record |= {"ended_by": ended}
        write_json(run_dir / PROVENANCE, record)
        for folder, network in module.networks.items():
            save_network(run_dir / folder / FILE_NAME, network, record | {"config": config, "metrics": metrics})
        write_json(run_dir / METRICS, metrics)
    log.info("Weights, metrics and logs are in %s.", printable(str(run_dir)))
    return metrics


def _refuse_other_settings(path: Path, cfg: DictConfig) -> None:
    """Raise a `UserError` where the run whose config is at `path` learns something else, or otherwise, than `cfg`."""
    remedy = "choose another run_dir, or start it from scratch with resume=false"
    configs = (OmegaConf.to_container(read_config(path, remedy)), OmegaConf.to_container(cfg, resolve=True))
    started, now = ({key: config.get(key) for key in _FIXED} for config in configs)
    refuse_other(path.parent, started, now, remedy)


def _earlier(path: Path) -> dict[str, Any]:
    """Of a run that goes on: the networks that it started from, and what it ran with before, attempt by attempt."""
    remedy = "choose another run_dir, or start the run from scratch with resume=false"
    before = read_json(path, _PROVENANCE, remedy)
    attempt = {key: before[key] for key in ("made", "versions", "machine", "commit")}
    return {"trained_from": before["trained_from"], "earlier": [*before.get("earlier", []), attempt]}


def _trainer(cfg: DictConfig, history: History) -> L.Trainer:
    callbacks = [_made(config, f"callbacks.{name}") for name, config in cfg.callbacks.items() if config is not None]
    loggers = [_made(config, f"logger.{name}") for name, config in cfg.logger.items() if config is not None]
    return _made(
        cfg.trainer,
        "trainer",
        default_root_dir=cfg.run_dir,
        callbacks=[EndsAtOnce(), StopStaysStopped(), ObjectiveMeasured(cfg.objective), history, *callbacks],
        logger=loggers,
        plugins=[AtomicCheckpointIO()] + ([] if started_from_outside() else [OwnProcesses()]),
    )


def _made(config: DictConfig, name: str, **options: Any) -> Any:
    """What a config makes, or a `UserError` with the words in which a library refuses it, as for want of a GPU."""
    try:
        return instantiate(config, **options)
    except InstantiationException as error:
        if isinstance(error.__cause__, UserError):
            raise error.__cause__ from None
        raise UserError(f"The {name} cannot be had as configured: {' '.join(str(error.__cause__).split())}") from None


@contextmanager
def _whole_checkpoint_said(run_dir: Path) -> Iterator[None]:
    """Have what stops a run, or what a full disk says, name the checkpoint from which the run can go on."""
    try:
        with naming(run_dir):
            yield
    except (OSError, Stopped) as stop:
        with suppress(UserError):
            good = newest_whole(run_dir / "checkpoints")
            stop.add_note(f"The same command goes on from {good}." if good else "No checkpoint was written yet.")
        raise


def _quiet() -> None:
    """Drop Lightning's advice that does not apply (batches are made on the device, no worker could help; schedules that
    watch a metric are stepped by the module) and what it says of its own use of torch."""
    warnings.filterwarnings("ignore", message=".*LeafSpec.*is deprecated.*")
    warnings.filterwarnings("ignore", message=".*does not have many workers.*")
    warnings.filterwarnings("ignore", message="ReduceLROnPlateau conditioned on metric .* not available")
    warnings.filterwarnings("ignore", message=".*Checkpoint directory .* exists and is not empty.*")
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)


if __name__ == "__main__":
    with in_sentences():
        try:
            train(OmegaConf.load(sys.argv[1]))
        except RunPruned:  # the first process reports it
            pass
        except Stopped as stop:  # likewise
            sys.exit(128 + stop.signum)
