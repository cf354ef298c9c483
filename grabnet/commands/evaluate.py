"""The command `evaluate`."""

from __future__ import annotations

from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry
from grabnet.commands.train import DATA_PATHS

PATHS = ("runs", "output", "cache_dir", "source.coarsenet", *DATA_PATHS)
LISTS = ("models", "grasps")


@hydra_entry("evaluate", paths=PATHS, lists=LISTS, folders=["output"])
def main(cfg: DictConfig) -> int:
    """Measure grasps of networks or of any other method, and write a report, tables and contact maps.

    grabnet evaluate [models=[open,<run>]] [grasps=<folder>] [output=DIR] [any value below]
    """
    from grabnet.evaluation.run import run

    return run(instantiate(cfg, _convert_="object"))
