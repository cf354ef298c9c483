"""Train a network: python train.py model=coarsenet | refinenet [any config value]; see configs/train.yaml."""

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from grabnet.cli import hydra_entry
from grabnet.errors import UserError


@hydra_entry("train")
def main(cfg: DictConfig) -> float:
    # Slow to import: a mistyped command should not wait for them.
    from lightning.fabric.utilities.exceptions import MisconfigurationException

    from grabnet.training_run import train

    cfg.run_dir = HydraConfig.get().runtime.output_dir
    try:
        return train(cfg)[cfg.objective]
    except MisconfigurationException as error:  # such as a callback without the logger that it needs
        raise UserError(f"The trainer cannot run as configured: {' '.join(str(error).split())}") from None


if __name__ == "__main__":
    main()
