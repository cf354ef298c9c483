"""The command `analyze`."""

from __future__ import annotations

from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry

PATHS = (
    "data.root", "data.models", "compare.root", "compare.models", "compare.meshes", "data.markers",
    "compare.markers", "compare.hand_file", "output",
)  # fmt: skip


@hydra_entry("analyze/analyze", paths=PATHS, folders=["output"])
def main(cfg: DictConfig) -> int:
    """Make the paper's statistics and figures of a data set.

    grabnet analyze data=open | data=grab data.root=<folder> data.models=<folder> [compare=…] [any value below]
    """
    from grabnet.analysis.run import run

    return run(instantiate(cfg, _convert_="all"))
