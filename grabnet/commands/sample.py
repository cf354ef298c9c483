"""The command `sample`."""

from __future__ import annotations

from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry

PATHS = ("output", "runs", "hand_model", "cache_dir")
LISTS = ("mesh", "model", "format")


@hydra_entry("sample/sample", paths=PATHS, lists=LISTS, folders=["output"])
def main(cfg: DictConfig) -> int:
    """Draw grasps of meshes, and write them with pictures and a page.

    grabnet sample mesh=cup.obj [n=20] [output=DIR] [any value below]
    """
    from grabnet.generation.run import run

    return run(instantiate(cfg, _convert_="all"))
