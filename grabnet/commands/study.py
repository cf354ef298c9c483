"""Make, run and analyse a study in which people judge grasps.

grabnet study export             # from models to videos and a page
grabnet study serve              # show the page, store answers
grabnet study analyse            # from answers to tables and a report
grabnet study simulate           # answers of synthetic raters, and what the analysis finds in them
grabnet study power              # how many raters and grasps a difference needs
grabnet study export --help      # the values of one of them
"""

from __future__ import annotations

from collections.abc import Callable

from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry
from grabnet.cli.subcommands import choose

# By command; with names of conditions, which may have any characters, too.
PATHS = {
    "export": ("output", "runs"),
    "serve": ("export", "certificate", "private_key"),
    "analyse": ("export", "videos", "output", "reference"),
    "simulate": ("export", "output"),
    "power": ("output",),
}
LISTS = {"export": ("models", "grasps", "conditions"), "analyse": ("answers",)}


@hydra_entry("study/export", paths=PATHS["export"], lists=LISTS["export"], folders=["output"])
def export(cfg: DictConfig) -> int:
    """Film grasps of models and ground truth, and make the page on which people judge them.

    grabnet study export [models=open] [objects=test] [n=20] [output=DIR] [any value below]
    """
    from grabnet.study.export import run

    return run(instantiate(cfg, _convert_="all"))


@hydra_entry("study/serve", paths=PATHS["serve"], folders=["export"])
def serve(cfg: DictConfig) -> int:
    """Serve an exported study, and store the answers.

    grabnet study serve export=DIR [host=127.0.0.1] [port=8000] [any value below]
    """
    from grabnet.study.serving import run

    return run(instantiate(cfg, _convert_="all"))


@hydra_entry("study/analyse", paths=PATHS["analyse"], lists=LISTS["analyse"], folders=["output"])
def analyse(cfg: DictConfig) -> int:
    """Filter raters, and report what the others answered.

    grabnet study analyse export=DIR [answers=FILE] [output=DIR] [any value below]
    """
    from grabnet.study.report import run

    return run(instantiate(cfg, _convert_="all"))


@hydra_entry("study/simulate", paths=PATHS["simulate"], folders=["output"])
def simulate(cfg: DictConfig) -> int:
    """Rehearse a study with synthetic raters, some of them careless.

    grabnet study simulate [export=DIR] [raters=200] [careless=0.3] [any value below]
    """
    from grabnet.study.simulation import run

    return run(instantiate(cfg, _convert_="all"))


@hydra_entry("study/power", paths=PATHS["power"], files=["output"])
def power(cfg: DictConfig) -> int:
    """Say how many raters and grasps a difference of mean answers needs.

    grabnet study power [difference=-0.2] [any value below]
    """
    from grabnet.study.power import run

    return run(instantiate(cfg, _convert_="all"))


COMMANDS: dict[str, Callable[[], int]] = {
    "export": export,
    "serve": serve,
    "analyse": analyse,
    "simulate": simulate,
    "power": power,
}


def main() -> int:
    """Run the command that the first argument names, on the arguments after it."""
    return choose("study", COMMANDS, __doc__ or "")
