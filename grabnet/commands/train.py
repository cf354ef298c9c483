"""The command `train`."""

from __future__ import annotations

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry

# Those of the groups that evaluate.yaml has, too.
DATA_PATHS = (
    "objects.dir",
    "hand_model.path",
    "data.root",
    "data.objects_dir",
    "data.cache_dir",
    "data.source.root",
    "data.source.release",
    "data.source.objects_dir",
)
PATHS = (
    "run_dir",
    "sweep_dir",
    *DATA_PATHS,
    "model.coarsenet",
    "model.refinenet",
    "model.source.coarsenet",
    "logger.csv.save_dir",
    "logger.wandb.save_dir",
    "callbacks.checkpoint.dirpath",
    "callbacks.last.dirpath",
    "callbacks.grasps.folder",
    "callbacks.pruning.siblings",
)


@hydra_entry("train", paths=PATHS)
def main(cfg: DictConfig) -> float:
    """Train a network; with -m, sweep over trainings.

    grabnet train model=coarsenet | refinenet | grabnet [data=…] [experiment=…] [any value below]
    """
    from grabnet.training.run import train

    cfg.run_dir = HydraConfig.get().runtime.output_dir
    return float(train(cfg)[cfg.objective])
