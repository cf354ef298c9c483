"""Entry points: Hydra's composition, with every user's mistake told in one sentence and exit code 2."""

from __future__ import annotations

import difflib
import functools
import logging
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException, InstantiationException, MissingConfigException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException

from grabnet.cli.checking import check
from grabnet.errors import UserError
from grabnet.io.shipped import shipped

log = logging.getLogger(__name__)

CONFIGS = shipped("configs")
# ${shipped:configs} in a config: the folder that it lies in.
OmegaConf.register_new_resolver("shipped", lambda name: str(shipped(name)), replace=True)


def hydra_entry(config_name: str) -> Callable[[Callable[[DictConfig], object]], Callable[[], None]]:
    """Decorate `main(cfg)` as a command that composes `configs/<config_name>.yaml` from the command line.

    Its groups are the folders beside that file: a name like "preprocess/preprocess" has groups of its own.
    """

    def decorate(main: Callable[[DictConfig], object]) -> Callable[[], None]:
        @functools.wraps(main)
        def job(cfg: DictConfig) -> object:
            try:
                return main(cfg)
            except (UserError, InstantiationException) as error:
                mistake = error if isinstance(error, UserError) else refusal(error)
                if mistake is None:
                    raise
                if HydraConfig.get().mode == RunMode.MULTIRUN:  # one run of many: the others go on
                    raise mistake from None
                fail(mistake)

        def entry() -> None:
            try:
                _rehearse(config_name, sys.argv[1:])
            except UserError as error:
                fail(error)
            folder, name = _place(config_name)
            hydra.main(version_base="1.3", config_path=str(folder), config_name=name)(job)()

        return entry

    return decorate


def refusal(error: InstantiationException) -> UserError | None:
    """What a constructor refused, which Hydra passes on, in a sentence; None where it failed for another reason."""
    cause = error.__cause__
    if isinstance(cause, UserError):
        return cause
    if not isinstance(cause, ValueError | TypeError):
        return None
    key = str(error).rpartition("full_key: ")[2]
    log.debug("%s was refused here:", key, exc_info=error)  # hydra.verbose=true, for those who write such a constructor
    return UserError(f"{key}: {' '.join(str(cause).split())}")


def fail(error: UserError) -> NoReturn:
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
        parsed = OverridesParser.create().parse_overrides(overrides)
        choices = [_choices(override) for override in parsed]
    except HydraException as error:
        raise UserError(_sentence(error)) from None
    # A sweep is rehearsed with each of its values in turn, those of the others being their first.
    first = [values[0] for values in choices]
    compose(config_name, first)
    for i, values in enumerate(choices):
        for value in values[1:]:
            compose(config_name, [*first[:i], value, *first[i + 1 :]])
    _try_folder(is_sweep=not {"-m", "--multirun"}.isdisjoint(arguments))


def _try_folder(is_sweep: bool) -> None:
    """Raise a `UserError` where Hydra could not make the folder of the composed run or sweep, or write to it."""
    settings = HydraConfig.get()
    if settings.output_subdir is None:  # it writes nothing
        return
    name, folder = ("sweep_dir", settings.sweep.dir) if is_sweep else ("run_dir", settings.run.dir)
    path = Path(folder).absolute()
    try:
        # Not the folder itself: in its name is the time, which will be another when Hydra makes it.
        tempfile.TemporaryDirectory(dir=next(p for p in (path, *path.parents) if p.exists())).cleanup()
    except OSError as error:
        raise UserError(f"{folder} cannot be written to ({error.strerror}): choose another {name}.") from None


def _choices(override: Override) -> list[str]:
    """What an override stands for: itself, each value of a sweep, or the ends of an interval."""
    if not override.is_sweep_override():
        return [override.input_line]
    sweep = override.value()
    values = [sweep.start, sweep.end] if override.is_interval_sweep() else override.sweep_string_iterator()
    choices = [f"{override.get_key_element()}={value}" for value in values]
    if not choices:
        raise UserError(f"{override.input_line} holds no value to try.")
    return choices


def compose(config_name: str, overrides: Sequence[str]) -> DictConfig:
    """`configs/<config_name>.yaml` with overrides, checked: what the command of that name would run with.

    Raises:
        UserError: an override that names or says what is not there.
    """
    folder, name = _place(config_name)
    running = GlobalHydra.instance().hydra  # of the command that asks
    GlobalHydra.instance().clear()
    try:
        with hydra.initialize_config_dir(str(folder), version_base="1.3"):
            cfg = hydra.compose(name, list(overrides), return_hydra_config=True)
        HydraConfig.instance().set_config(cfg)  # for interpolations such as ${hydra:runtime.choices.model}
    except (HydraException, OmegaConfBaseException) as error:
        raise UserError(_sentence(error)) from None
    finally:
        if running is not None:
            GlobalHydra.instance().initialize(running)
    with open_dict(cfg):
        del cfg["hydra"]
    check(cfg)
    return cfg


def _place(config_name: str) -> tuple[Path, str]:
    """The folder that a config is composed from, and its name in it."""
    return (CONFIGS / config_name).parent, (CONFIGS / config_name).name


def _sentence(error: Exception) -> str:
    if isinstance(error, MissingConfigException):
        group, _, name = (error.missing_cfg_file or "").rpartition("/")
        options = error.options or sorted(p.stem for p in (CONFIGS / group).glob("*.yaml"))
        return f"There is no {group} '{name}'; {group} can be {', '.join(options)}."
    cause = error if isinstance(error, OmegaConfBaseException) else error.__cause__
    if isinstance(cause, ConfigAttributeError | ConfigKeyError) and cause.parent_node is not None:
        names = [str(k) for k in cause.parent_node if k not in ("hydra", "_target_")]
        close = difflib.get_close_matches(str(cause.key), names, n=1)
        where = (cause.full_key or "").rpartition(".")[0] or "the config"
        if close:
            hint = f"did you mean {close[0]}? It has {', '.join(names)}"
        elif "_target_" in cause.parent_node:  # its other values are not listed
            hint = f"it has {', '.join(names) or 'none'}; if its target takes it, write +{cause.full_key}=…"
        else:
            hint = f"it has {', '.join(names)}"
        return f"Unknown key '{cause.full_key}' in {where}; {hint}."
    return " ".join(str(error).split())
