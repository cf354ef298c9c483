"""The command `mosh`, and those of its own, such as `mosh place`."""

from __future__ import annotations

from collections.abc import Callable

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import hydra_entry
from grabnet.cli.subcommands import choose

# By command; that of `grabnet mosh` itself first.
PATHS = {
    "": ("capture", "layout", "subject", "out", "models", "objects", "meshes"),
    "place": ("markers", "subject", "models", "output"),
    "draw": ("layout", "subject", "models", "output"),
    "synthesise": ("root", "out", "layout", "models"),
    "judge": ("truth", "solved", "contact", "models", "output"),
    "evaluate": ("root", "layout", "output", "sweep_dir"),
}


@hydra_entry("mosh/mosh", paths=PATHS[""], folders=["out"])
def solve(cfg: DictConfig) -> int:
    """Make recordings of body, hands, face and object from motion-capture markers.

    grabnet mosh capture=<file or folder> [layout=FILE] [subject=FILE.ply] [objects=FILE] [out=DIR] [any value below]
    grabnet mosh place [any of its values]      # a layout on any body model, by names of anatomical places
    grabnet mosh draw [any of its values]       # picture and page of a layout
    grabnet mosh synthesise [any of its values] # captures of recordings, whose truth is known
    grabnet mosh judge [any of its values]      # how far solved recordings are from the truth
    grabnet mosh evaluate [any of its values]   # how accurate it is, on synthetic captures
    """
    from grabnet.mosh.run import run

    return run(instantiate(cfg, _convert_="all"))


@hydra_entry("mosh/place", paths=PATHS["place"], files=["output"])
def place(cfg: DictConfig) -> int:
    """Place the markers of a layout on a body model by names of anatomical places, and draw them.

    grabnet mosh place [markers=grab99] [models=DIR] [gender=male] [output=FILE.yaml] [any value below]
    """
    from grabnet.mosh.layout_commands import place

    return place(instantiate(cfg, _convert_="all"))


@hydra_entry("mosh/draw", paths=PATHS["draw"], files=["output"])
def draw(cfg: DictConfig) -> int:
    """Draw a layout on its body model: a picture, and a page that lists the markers.

    grabnet mosh draw [layout=FILE] [models=DIR] [gender=male] [output=FILE.png] [any value below]
    """
    from grabnet.mosh.layout_commands import draw

    return draw(instantiate(cfg, _convert_="all"))


@hydra_entry("mosh/synthesise", paths=PATHS["synthesise"], folders=["out"])
def synthesise(cfg: DictConfig) -> int:
    """Make c3d files of recordings, as a motion-capture system would have seen them, and keep the truth beside them.

    grabnet mosh synthesise [root=DIR] [recordings=[s8/mug_lift_1]] [out=DIR] [any value below]
    """
    from grabnet.mosh.synthesising import run

    return run(instantiate(cfg, _convert_="all"))


@hydra_entry("mosh/judge", paths=PATHS["judge"], files=["output"])
def judge(cfg: DictConfig) -> int:
    """Compare solved recordings with those that were captured: bodies, objects and contact.

    grabnet mosh judge truth=DIR solved=DIR [contact=DIR] [any value below]
    """
    from grabnet.mosh.judging import run

    return run(instantiate(cfg, _convert_="all"))


@hydra_entry("mosh/evaluate", paths=PATHS["evaluate"], folders=["output"])
def evaluate(cfg: DictConfig) -> int:
    """Measure how accurate mosh is, on synthetic captures of recordings.

    grabnet mosh evaluate [root=DIR] [subjects=[s8,s9]] [any value below]
    grabnet mosh evaluate -m search=weights sweep_dir=DIR   # look for better values
    """
    from grabnet.mosh.evaluation import run

    if HydraConfig.get().mode == RunMode.MULTIRUN:
        cfg.output = HydraConfig.get().runtime.output_dir
    return run(instantiate(cfg, _convert_="object"))


COMMANDS: dict[str, Callable[[], int]] = {
    "place": place,
    "draw": draw,
    "synthesise": synthesise,
    "judge": judge,
    "evaluate": evaluate,
}


def main() -> int:
    """Solve captures, or run the command that the first argument names, on the arguments after it."""
    return choose("mosh", COMMANDS, "", default=solve)
