"""The command `evaluate`."""

from __future__ import annotations

from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry

PATHS = (
    "runs",
    "output",
    "cache_dir",
    "objects.dir",
    "hand_model.path",
    "data.root",
    "data.objects_dir",
    "data.cache_dir",
    "data.source.root",
    "data.source.release",
    "data.source.objects_dir",
    "source.coarsenet",
)
LISTS = ("models", "grasps")


@hydra_entry("evaluate", paths=PATHS, lists=LISTS)
def main(cfg: DictConfig) -> int:
    """Measure grasps of networks or of any other method, and write a report, tables and contact maps.

    grabnet evaluate [models=[open,<run>]] [grasps=<folder>] [output=DIR] [any value below]
    """
    from grabnet.evaluation.run import run

    return run(instantiate(cfg, _convert_="object"))
