"""Commands that take their values from a config: Hydra's composition, with every mistake in one sentence.

Exit codes of every command:
    0: all was done.
    1: what the lines "error: …" name failed, and the rest was done.
    2: it could not start, or had to end, for the reason in the last line, "error: …".
    130, 143: it was stopped, by Ctrl-C or by SIGTERM.
    141: the reader of its output has gone.
"""

from __future__ import annotations

import functools
import inspect
import logging
import os
import sys
from argparse import Namespace
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import hydra
from hydra import version
from hydra._internal.hydra import Hydra
from hydra._internal.utils import create_config_search_path, get_args_parser
from hydra.core.config_search_path import SearchPathQuery
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException, InstantiationException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from grabnet.cli.checking import check, refusal, refuse_removal
from grabnet.cli.ends import as_user_error, fail, in_sentences, say, unexpected
from grabnet.cli.help import command_help
from grabnet.cli.mistakes import options, refuse_choices, sentence
from grabnet.cli.places import refuse_unwritable
from grabnet.cli.progress import shown
from grabnet.cli.quoting import quoted
from grabnet.errors import UserError
from grabnet.io.shipped import shipped

log = logging.getLogger(__name__)

CONFIGS = shipped("configs")
# ${shipped:configs} in a config: the folder that it lies in.
OmegaConf.register_new_resolver("shipped", lambda name: str(shipped(name)), replace=True)

Main = Callable[[DictConfig], object]


def hydra_entry(
    config_name: str,
    paths: Collection[str] = (),
    lists: Collection[str] = (),
    folders: Collection[str] = (),
    files: Collection[str] = (),
) -> Callable[[Main], Callable[[], int]]:
    """Decorate `main(cfg)` as a command that composes `configs/<config_name>.yaml` from the command line.

    Its groups are the folders beside that file: a name like "preprocess/preprocess" has groups of its own. The config
    is composed twice: once here, to find mistakes before anything is written, and then by Hydra for the run.

    Args:
        config_name: without .yaml.
        paths: values that are a file name each, which may have any characters.
        lists: values that may be several file names.
        folders, files: those of the paths that the command writes to.

    Returns:
        a decorator of `main(cfg)`, which returns an exit code or, for sweeps, the objective as a float. It makes a
        function without arguments of it, which reads the command line and returns the exit code.
    """
    written = dict.fromkeys(folders, True) | dict.fromkeys(files, False)

    def decorate(main: Main) -> Callable[[], int]:
        @functools.wraps(main)
        def entry() -> int:
            given = quoted(sys.argv[1:], paths, lists)
            arguments = get_args_parser().parse_intermixed_args(given)
            # Hydra reads values only before or after its options.
            sys.argv[1:] = [*(a for a in given if a not in arguments.overrides), *arguments.overrides]
            codes, keeps_traceback = [0], os.environ.get("HYDRA_FULL_ERROR") == "1"

            @functools.wraps(main)
            def job(cfg: DictConfig) -> object:
                try:
                    with shown(quiet=bool(cfg.get("quiet"))):
                        result = main(cfg)
                except Exception as error:
                    refused = refusal(error) if isinstance(error, InstantiationException) else None
                    mistake = refused or as_user_error(error)
                    if mistake is not None:
                        log.debug("Refused here:", exc_info=error)  # hydra.verbose=true, for who writes a constructor
                    if HydraConfig.get().mode != RunMode.MULTIRUN and (mistake or not keeps_traceback):
                        fail(mistake or UserError(unexpected(error)))  # here, since Hydra announces what a run raises
                    if not HydraConfig.get().sweeper._target_.startswith("hydra."):  # ours records what failed
                        raise (mistake or error) from None
                    say(str(mistake or unexpected(error)))
                    result = 1  # the other runs continue
                if isinstance(result, int):
                    codes.append(result)
                return result

            folder, name = _place(config_name, arguments)
            with _hydra(folder, name, arguments.config_dir) as composer:
                if arguments.help:
                    with _in_sentences(composer, arguments.overrides):
                        print(command_help(composer, name, arguments.overrides, inspect.getdoc(main) or ""))
                    return 0
                if arguments.experimental_rerun is not None:
                    raise UserError("--experimental-rerun would run what a pickle says: give the run's values instead.")
                if _runs(arguments):
                    cfg = _rehearse(composer, name, arguments.overrides)
                    _refuse_places(cfg, arguments.multirun, [*paths, *lists], written)
            with _hydra_raises():
                hydra.main(version_base="1.3", config_path=str(folder), config_name=name)(job)()
            return max(codes)

        @functools.wraps(main)
        def command() -> int:
            with in_sentences():
                return entry()

        return command

    return decorate


def compose(config_name: str, overrides: Sequence[str]) -> DictConfig:
    """`configs/<config_name>.yaml` with overrides, checked: what the command of that name would run with.

    Raises:
        UserError: an override that names or says what is not there.
    """
    folder, name = _place(config_name)
    with _hydra(folder, name) as composer:
        return _composed(composer, name, overrides)


def _place(config_name: str, arguments: Namespace | None = None) -> tuple[Path, str]:
    """The folder that a config is composed from, and its name in it; or others, named by Hydra's options."""
    folder, name = (CONFIGS / config_name).parent, (CONFIGS / config_name).name
    if arguments is None:
        return folder, name
    if arguments.config_path is not None and not Path(arguments.config_path).is_absolute():
        raise UserError(f"--config-path {arguments.config_path} must be absolute; --config-dir adds a folder to ours.")
    return Path(arguments.config_path or folder), arguments.config_name or name


@contextmanager
def _hydra(folder: Path, name: str, more: str | None = None) -> Iterator[Hydra]:
    """A Hydra beside the one that may be running, with the configs of `folder`, of the folders that the config `name`
    there has in hydra.searchpath, and of a further folder."""
    version.setbase("1.3")
    own = folder / f"{name}.yaml"
    further = list(OmegaConf.select(OmegaConf.load(own), "hydra.searchpath") or []) if own.is_file() else []
    if more is not None:
        if not Path(more).is_dir():
            raise UserError(f"--config-dir {more} is no folder.")
        further.append(f"file://{Path(more).absolute()}")
    search_path = create_config_search_path(str(folder))
    for path in further:
        search_path.prepend("command-line", path, SearchPathQuery(provider="schema"))  # Hydra needs its schema last
    running = GlobalHydra.instance().hydra
    GlobalHydra.instance().clear()
    try:
        yield Hydra.create_main_hydra2("grabnet", search_path)
    finally:
        GlobalHydra.instance().clear()
        if running is not None:
            GlobalHydra.instance().initialize(running)


def _runs(arguments: Namespace) -> bool:
    """Whether the command does its work, rather than print what Hydra knows about it."""
    asks = (arguments.cfg, arguments.info, arguments.hydra_help, arguments.shell_completion)
    return not any(asks)


def _rehearse(composer: Hydra, config_name: str, arguments: list[str]) -> DictConfig:
    """Compose and check the config as Hydra will, so that its mistakes surface at once and in one sentence.

    Returns:
        the config; of a sweep, its first.
    """
    if bare := next((a for a in arguments if "=" not in a and not a.startswith("~")), None):
        raise UserError(f"The argument '{bare}' has no value: give it as {_meant(composer, config_name, bare)}.")
    choices = [_choices(override) for override in _parsed(arguments)]
    # A sweep is rehearsed with each of its values in turn, those of the others being their first.
    first = [values[0] for values in choices]
    cfg = _composed(composer, config_name, first)
    for i, values in enumerate(choices):
        for value in values[1:]:
            _composed(composer, config_name, [*first[:i], value, *first[i + 1 :]])
    return cfg


def _meant(composer: Hydra, config_name: str, bare: str) -> str:
    """What an argument without a key may be meant for: a file of a group, or the value that must be given."""
    defaults = composer.config_loader.compute_defaults_list(config_name, [], RunMode.RUN)
    groups = {choice.partition("@")[0] for choice in defaults.overrides.known_choices if not choice.startswith("hydra")}
    if chosen := sorted(f"{group}={bare}" for group in groups if bare in options(composer.config_loader, group)):
        return " or ".join(chosen)
    cfg = composer.config_loader.load_configuration(config_name, [], RunMode.RUN)
    with open_dict(cfg):
        del cfg["hydra"]
    missing = sorted(OmegaConf.missing_keys(cfg))
    return f"{missing[0]}={bare}" if missing else f"{bare}=…"


def _parsed(arguments: Sequence[str]) -> list[Override]:
    """The overrides that arguments are, in Hydra's grammar."""
    overrides = []
    for argument in arguments:
        if "=" not in argument and not argument.startswith("~"):
            raise UserError(f"The argument '{argument}' has no value: give it as {argument}=…")
        try:
            overrides.append(OverridesParser.create().parse_override(argument))
        except HydraException:
            key, _, value = argument.partition("=")
            raise UserError(
                f"The argument {argument} cannot be read: quote a value with special characters twice, as in "
                f"\"{key}='{value}'\"."
            ) from None
    return overrides


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


def _composed(composer: Hydra, config_name: str, arguments: Sequence[str]) -> DictConfig:
    with _in_sentences(composer, arguments):
        cfg = hydra.compose(config_name, list(arguments), return_hydra_config=True)
        HydraConfig.instance().set_config(cfg)  # for interpolations such as ${hydra:runtime.choices.model}
        with open_dict(cfg):
            del cfg["hydra"]
        for override in _parsed(arguments):
            if override.is_delete():
                refuse_removal(cfg, override.key_or_group)
        check(cfg)  # which resolves what the values refer to
    return cfg


@contextmanager
def _in_sentences(composer: Hydra, arguments: Sequence[str]) -> Iterator[None]:
    """Raise as `UserError` what Hydra finds wrong with the arguments that are composed and checked in the block."""
    overrides = _parsed(arguments)
    refuse_choices(composer.config_loader, overrides)
    try:
        yield
    except InstantiationException:  # a fault of what was made
        raise
    except (HydraException, OmegaConfBaseException) as error:
        keys = [override.key_or_group for override in overrides]
        raise UserError(sentence(error, composer.config_loader, keys)) from None


def _refuse_places(cfg: DictConfig, is_sweep: bool, paths: Collection[str], written: dict[str, bool]) -> None:
    """Raise a `UserError` for a path that is empty, and where the command could not write what it will.

    Args:
        paths: keys of all paths.
        written: whether it is a folder, of the keys of those that are written to.
    """
    for key in paths:
        if OmegaConf.select(cfg, key) == "":
            raise UserError(f"{key} is empty: give a file or folder as {key}=…")
    settings = HydraConfig.get()
    if settings.output_subdir is not None:  # Hydra, too, writes there
        name, folder = ("sweep_dir", settings.sweep.dir) if is_sweep else ("run_dir", settings.run.dir)
        refuse_unwritable(folder, name, is_folder=True)
    for key, is_folder in written.items():
        if (path := OmegaConf.select(cfg, key)) is not None:
            refuse_unwritable(path, key, is_folder)


@contextmanager
def _hydra_raises() -> Iterator[None]:
    """Have Hydra raise what it would print with a traceback."""
    before = os.environ.get("HYDRA_FULL_ERROR")
    os.environ["HYDRA_FULL_ERROR"] = "1"
    try:
        yield
    finally:
        del os.environ["HYDRA_FULL_ERROR"]
        if before is not None:
            os.environ["HYDRA_FULL_ERROR"] = before
