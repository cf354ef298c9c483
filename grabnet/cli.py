"""Entry points: Hydra's composition, with every user's mistake told in one sentence and exit code 2."""

from __future__ import annotations

import difflib
import functools
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException, InstantiationException, MissingConfigException
from omegaconf import DictConfig, open_dict
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException

from grabnet.config import check
from grabnet.errors import UserError

CONFIGS = Path(__file__).parents[1] / "configs"


def hydra_entry(config_name: str) -> Callable[[Callable[[DictConfig], object]], Callable[[], None]]:
    """Decorate `main(cfg)` as a command that composes `configs/<config_name>.yaml` from the command line."""

    def decorate(main: Callable[[DictConfig], object]) -> Callable[[], None]:
        @functools.wraps(main)
        def job(cfg: DictConfig) -> object:
            try:
                return main(cfg)
            except UserError as error:
                fail(error)
            except InstantiationException as error:  # how Hydra passes on what a constructor raised
                if not isinstance(error.__cause__, UserError):
                    raise
                fail(error.__cause__)

        def entry() -> None:
            try:
                _rehearse(config_name, sys.argv[1:])
            except UserError as error:
                fail(error)
            hydra.main(version_base="1.3", config_path=str(CONFIGS), config_name=config_name)(job)()

        return entry

    return decorate


def fail(error: UserError) -> None:
    """Print the sentence and leave."""
    print(f"error: {error}", file=sys.stderr)
    sys.exit(2)


def _rehearse(config_name: str, arguments: list[str]) -> None:
    """Compose and check the config as Hydra will, so that its mistakes surface at once and in one sentence."""
    if any(a in ("--help", "-h", "--hydra-help", "--version", "--info", "-i", "--cfg", "-c") for a in arguments):
        return
    overrides = [a for a in arguments if not a.startswith("-")]
    if strange := [a for a in overrides if "=" not in a and not a.startswith("~")]:
        raise UserError(f"The argument '{strange[0]}' has no value: give it as {strange[0]}=…")
    try:
        # A sweep is rehearsed with the first value of each choice.
        for parsed in (OverridesParser.create().parse_override(o) for o in overrides):
            if parsed.is_sweep_override():
                first = next(iter(parsed.sweep_string_iterator()))
                overrides[overrides.index(parsed.input_line)] = f"{parsed.input_line.split('=', 1)[0]}={first}"
    except HydraException as error:
        raise UserError(_sentence(error)) from None
    compose(config_name, overrides)


def compose(config_name: str, overrides: Sequence[str]) -> DictConfig:
    """`configs/<config_name>.yaml` with overrides, checked: what the command of that name would run with.

    Raises:
        UserError: an override that names or says what is not there.
    """
    try:
        with hydra.initialize_config_dir(str(CONFIGS), version_base="1.3"):
            cfg = hydra.compose(config_name, list(overrides), return_hydra_config=True)
        HydraConfig.instance().set_config(cfg)  # for interpolations such as ${hydra:runtime.choices.model}
    except (HydraException, OmegaConfBaseException) as error:
        raise UserError(_sentence(error)) from None
    with open_dict(cfg):
        del cfg["hydra"]
    check(cfg)
    return cfg


def _sentence(error: Exception) -> str:
    if isinstance(error, MissingConfigException):
        group, _, name = (error.missing_cfg_file or "").rpartition("/")
        options = error.options or sorted(p.stem for p in (CONFIGS / group).glob("*.yaml"))
        return f"There is no {group} '{name}'; {group} can be {', '.join(options)}."
    cause = error if isinstance(error, OmegaConfBaseException) else error.__cause__
    if isinstance(cause, ConfigAttributeError | ConfigKeyError) and cause.parent_node is not None:
        names = [str(k) for k in cause.parent_node if k not in ("hydra", "_target_")]
        close = difflib.get_close_matches(str(cause.key), names, n=1)
        hint = f"did you mean {close[0]}? It" if close else "it"
        where = (cause.full_key or "").rpartition(".")[0] or "the config"
        return f"Unknown key '{cause.full_key}' in {where}; {hint} has {', '.join(names)}."
    return " ".join(str(error).split())
