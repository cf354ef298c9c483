"""The command `preprocess`."""

from __future__ import annotations

from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry

PATHS = ("data.root", "data.models", "data.contact_output", "output", "cache_dir")


@hydra_entry("preprocess/preprocess", paths=PATHS, folders=["output", "data.contact_output"])
def main(cfg: DictConfig) -> int:
    """Make training frames of recordings.

    grabnet preprocess data=open | data=grab data.root=<folder> data.models=<folder> [any value below]
    """
    from grabnet.preprocess.run import run

    return run(instantiate(cfg, _convert_="all"))
