"""Grasps of meshes: `python scripts/sample.py mesh=cup.obj n=20 output=DIR`; all values are in configs/sample/."""

from __future__ import annotations

import sys

from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry
from grabnet.cli.quoting import quoted

PATHS = ("mesh", "output", "format", "model", "runs", "hand_model", "cache_dir")


@hydra_entry("sample/sample")
def main(cfg: DictConfig) -> None:
    from grabnet.generation.run import run

    sys.exit(run(instantiate(cfg, _convert_="all")))


if __name__ == "__main__":
    sys.argv[1:] = quoted(sys.argv[1:], PATHS)
    main()
