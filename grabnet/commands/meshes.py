"""The command `meshes`."""

from __future__ import annotations

from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry

PATHS = ("data.root", "data.models", "sequence", "output")


@hydra_entry("analyze/meshes", paths=PATHS, folders=["output"])
def main(cfg: DictConfig) -> int:
    """Write meshes of a recording over time: a film, an animation, or files of each frame.

    grabnet meshes sequence=<subject>/<recording> [every=4] [data=grab data.root=<folder> data.models=<folder>]
    """
    from grabnet.analysis.motion import run

    return run(instantiate(cfg, _convert_="all"))
