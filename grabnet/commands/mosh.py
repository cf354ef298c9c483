"""The command `mosh`, and `mosh evaluate`."""

from __future__ import annotations

import sys

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry

PATHS = ("capture", "layout", "subject", "out", "models", "objects", "meshes")


@hydra_entry("mosh/mosh", paths=PATHS, folders=["out"])
def solve(cfg: DictConfig) -> int:
    """Make recordings of body, hands, face and object from motion-capture markers.

    grabnet mosh capture=<file or folder> [layout=FILE] [subject=FILE.ply] [objects=FILE] [out=DIR] [any value below]
    grabnet mosh evaluate [any of its values]   # how accurate it is, on synthetic captures
    """
    from grabnet.mosh.run import run

    return run(instantiate(cfg, _convert_="all"))


@hydra_entry("mosh/evaluate", paths=("root", "layout", "output", "sweep_dir"), folders=["output"])
def evaluate(cfg: DictConfig) -> int:
    """Measure how accurate mosh is, on synthetic captures of recordings.

    grabnet mosh evaluate [root=DIR] [subjects=[s8,s9]] [any value below]
    grabnet mosh evaluate -m search=weights sweep_dir=DIR   # look for better values
    """
    from grabnet.mosh.evaluation import run

    if HydraConfig.get().mode == RunMode.MULTIRUN:
        cfg.output = HydraConfig.get().runtime.output_dir
    return run(instantiate(cfg, _convert_="object"))


def main() -> int:
    if sys.argv[1:2] == ["evaluate"]:
        del sys.argv[1]
        return evaluate()
    return solve()
