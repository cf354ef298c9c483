"""What `--help` prints: a command's config files with their comments, and the groups that it has."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from hydra._internal.hydra import Hydra
from hydra.types import RunMode

from grabnet.cli.mistakes import options

EXIT_CODES = """\
Exit codes: 0: all was done. 1: what the lines "error: …" name failed, and the rest was done. 2: it could not start, or
had to end, for the reason in the last line, "error: …". 130, 143: it was stopped, by Ctrl-C or by SIGTERM. 141: the
reader of its output has gone."""
_HYDRA = """\
Hydra's own options: --cfg job prints the values as composed, --info the files that they come from; -m sweeps over
comma-separated values; --config-dir DIR adds a folder of your own config files; -sc install=bash completes keys and
values; --hydra-help lists the others."""


def command_help(hydra: Hydra, config_name: str, overrides: list[str], about: str) -> str:
    """A page about a command.

    Args:
        hydra: with the command's search path.
        config_name: of the command's config.
        overrides: of the command line; groups chosen there are those that are shown.
        about: what the command does.
    """
    defaults = hydra.config_loader.compute_defaults_list(config_name, overrides, RunMode.RUN)
    own = [d for d in defaults.defaults if d.config_path and not d.config_path.startswith("hydra/")]
    groups = {key: choice for key, choice in defaults.overrides.known_choices.items() if not key.startswith("hydra")}
    sections = [about, EXIT_CODES]
    if groups:
        sections.append("\n".join(["Groups, of which a file is chosen by its name:", *_group_lines(hydra, groups)]))
    # The command's own values first, though groups may be composed before them.
    for default in sorted(own, key=lambda d: d.config_path != config_name):
        path = _path(hydra, default.config_path)
        heading = f"{path.name}" if default.config_path == config_name else f"{default.config_path}.yaml"
        below = f", below {default.package}" if default.package else ""
        if text := _values(path.read_text(encoding="utf-8")):
            sections.append(f"── {heading}{below} {'─' * max(0, 100 - len(heading + below))}\n{text}")
    return "\n\n".join([*sections, _HYDRA])


def _group_lines(hydra: Hydra, groups: dict[str, str | None]) -> Iterator[str]:
    for key, choice in sorted(groups.items()):
        others = [name for name in options(hydra.config_loader, key.partition("@")[0]) if name != choice]
        if others:
            yield f"  {key}={choice or 'null'} (or {', '.join(others)})"


def _path(hydra: Hydra, config_path: str) -> Path:
    for source in hydra.config_loader.get_sources():
        path = Path(source.path) / f"{config_path}.yaml"
        if source.scheme() == "file" and path.exists():
            return path
    raise FileNotFoundError(config_path)  # composed from it a moment ago


def _values(text: str) -> str:
    """A config file without what is Hydra's: its defaults list, its own settings, and package headers."""
    text = re.sub(r"^# @package .*\n", "", text, flags=re.MULTILINE)
    text = re.sub(r"^(defaults|hydra):.*\n(([ \t].*)?\n)*", "", text + "\n", flags=re.MULTILINE)
    text = re.sub(r"^_(target|partial|recursive|convert)_:.*\n", "", text, flags=re.MULTILINE)
    return re.sub(r"\n{3,}", "\n\n", text).strip()
