"""The command `benchmark`."""

from __future__ import annotations

from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry

PATHS = ("output",)


@hydra_entry("benchmark", paths=PATHS, files=["output"])
def main(cfg: DictConfig) -> int:
    """Time the code against plainer baselines.

    grabnet benchmark suite=<name> [output=FILE] [any value below]
    """
    from grabnet.benchmarks.run import run

    return run(instantiate(cfg, _convert_="all"))
