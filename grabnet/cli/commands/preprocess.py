"""The command `preprocess`."""

from __future__ import annotations

from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry

PATHS = ("open.root", "grab.root", "models.root", "output", "cache_dir")


@hydra_entry("preprocess/preprocess", paths=PATHS)
def main(cfg: DictConfig) -> int:
    """Make training frames of recordings.

    grabnet preprocess data=open | data=grab grab.root=<folder> models.root=<folder> [any value below]
    """
    from grabnet.preprocess.pipeline import preprocess

    return preprocess(instantiate(cfg, _convert_="all"))
