"""Tables of the paper and of the field: `python scripts/evaluate.py models=[open,<run>] output=DIR`; all
values are in configs/evaluate.yaml."""

from __future__ import annotations

import sys

from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry
from grabnet.cli.quoting import quoted

PATHS = ("models", "runs", "grasps", "output", "cache_dir", "objects.dir", "hand_model.path")


@hydra_entry("evaluate")
def main(cfg: DictConfig) -> None:
    from grabnet.evaluation.run import run

    sys.exit(run(instantiate(cfg, _convert_="object")))


if __name__ == "__main__":
    sys.argv[1:] = quoted(sys.argv[1:], PATHS)
    main()
