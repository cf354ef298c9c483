"""From recordings to training frames: python scripts/preprocess.py data=open | data=grab data.root=… data.models=…;
all values are in configs/preprocess/."""

from __future__ import annotations

import sys

from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry
from grabnet.cli.quoting import quoted

PATHS = ("data.root", "data.models", "data.contact_output", "output", "cache_dir")


@hydra_entry("preprocess/preprocess")
def main(cfg: DictConfig) -> None:
    from grabnet.preprocess.run import run

    sys.exit(run(instantiate(cfg, _convert_="all")))


if __name__ == "__main__":
    sys.argv[1:] = quoted(sys.argv[1:], PATHS)
    main()
