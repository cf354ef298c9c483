"""Timings beside those of a plainer way: `python scripts/benchmark.py suite=sdf`; values in configs/benchmark.yaml."""

from __future__ import annotations

from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry


@hydra_entry("benchmark")
def main(cfg: DictConfig) -> None:
    instantiate(cfg, _convert_="all").run()


if __name__ == "__main__":
    main()
