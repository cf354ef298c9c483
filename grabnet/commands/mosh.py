"""The command `mosh`."""

from __future__ import annotations

from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry

PATHS = ("capture", "layout", "subject", "out", "models", "objects", "meshes")


@hydra_entry("mosh/mosh", paths=PATHS)
def main(cfg: DictConfig) -> int:
    """Make recordings of body, hands, face and object from motion-capture markers.

    grabnet mosh capture=<file or folder> [layout=FILE] [subject=FILE.ply] [objects=FILE] [out=DIR] [any value below]
    """
    from grabnet.mosh.run import run

    return run(instantiate(cfg, _convert_="all"))
