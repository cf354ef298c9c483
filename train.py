"""Train a network: python train.py model=coarsenet | refinenet [any config value]; see configs/train.yaml."""

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry


@hydra_entry("train")
def main(cfg: DictConfig) -> float:
    from grabnet.training.run import train  # slow to import: a mistyped command should not wait for it

    cfg.run_dir = HydraConfig.get().runtime.output_dir
    return train(cfg)[cfg.objective]


if __name__ == "__main__":
    main()
