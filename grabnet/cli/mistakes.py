"""Mistakes on the command line, each in one sentence that names what exists."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence

from hydra.core.config_loader import ConfigLoader
from hydra.core.object_type import ObjectType
from hydra.core.override_parser.types import Override
from hydra.errors import MissingConfigException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    InterpolationResolutionError,
    OmegaConfBaseException,
    UnsupportedInterpolationType,
)

from grabnet.errors import UserError

# What other code calls it: the value that a config must have for the hint to be right, and the hint.
_ALIASES = {
    "ckpt_path": ("resume", "give resume=true with run_dir=<run folder>"),
    "networks": ("model", "give model=<run folder>"),
}


def options(loader: ConfigLoader, group: str) -> list[str]:
    """The files of a config group that can be chosen; those with a leading _ are parts of others."""
    return [name for name in sorted(loader.get_group_options(group, ObjectType.CONFIG)) if not name.startswith("_")]


def refuse_choices(loader: ConfigLoader, overrides: Sequence[Override]) -> None:
    """Raise a `UserError` for a group that is removed, or chosen by what is no file name: Hydra's words for these are
    those of its own code."""
    for override in overrides:
        key = override.key_or_group
        if override.is_delete() and options(loader, key) and override.package is None:
            raise UserError(f"~{key} removes what the command needs: remove single values, as in ~{key}.<value>.")
        if override.is_sweep_override() or not options(loader, key):
            continue
        value = override.value()
        chosen = value if isinstance(value, list) else [value]
        if not chosen or not all(isinstance(name, str) and name and not name.startswith("_") for name in chosen):
            found = ", ".join(options(loader, key))
            raise UserError(f"{override.input_line} names no file of the group {key}; it can be {found}.")


def sentence(error: Exception, loader: ConfigLoader, keys: Sequence[str]) -> str:
    """What Hydra or OmegaConf found wrong.

    Args:
        error: theirs.
        keys: of the overrides that were given, in full.
    """
    if isinstance(error, MissingConfigException):
        group, _, name = (error.missing_cfg_file or "").rpartition("/")
        if not group:
            return f"There is no config '{name}'."
        return f"There is no {group} '{name}'; {group} can be {', '.join(options(loader, group))}."
    if isinstance(error, InterpolationResolutionError | UnsupportedInterpolationType):
        reason = str(error).partition("\n")[0]
        return f"{error.full_key} refers to what cannot be resolved ({reason}): give it another value."
    cause = error if isinstance(error, OmegaConfBaseException) else error.__cause__
    if isinstance(cause, ConfigAttributeError | ConfigKeyError) and cause.parent_node is not None:
        return _unknown_key(cause, keys)
    reason = str(error.__cause__ or "").partition("\n")[0]
    return " ".join(f"{error}{f' ({reason})' if reason and reason not in str(error) else ''}.".split())


def _unknown_key(cause: ConfigAttributeError | ConfigKeyError, keys: Sequence[str]) -> str:
    full_key = cause.full_key or ""
    where = full_key.rpartition(".")[0]
    parent, root = cause.parent_node, cause.parent_node._get_root()
    names = [str(k) for k in parent if k != "hydra" and not str(k).startswith("_")]
    listed = f"{where or 'the config'} has {', '.join(names) or 'none'}"
    # OmegaConf names the first part that it does not know: of loss.vertex, loss.
    asked = next((k for k in keys if k.startswith(f"{full_key}.")), full_key)
    value, hint = _ALIASES.get(full_key, ("", ""))
    if value in root and not OmegaConf.is_dict(root[value]):
        return f"Unknown key '{full_key}'; {hint}."
    if found := _elsewhere(asked, root):
        return f"Unknown key '{asked}'; did you mean {' or '.join(found[:3])}?"
    if close := difflib.get_close_matches(str(cause.key), names, n=1):
        return f"Unknown key '{full_key}'; did you mean {_below(where, close[0])}? ({listed})"
    if "_target_" in parent and where:  # its other values are not listed
        return f"Unknown key '{full_key}'; {listed}; if its target takes it, write +{full_key}=…"
    if found := _elsewhere(asked, root, cutoff=0.8):
        return f"Unknown key '{asked}'; did you mean {' or '.join(found[:3])}?"
    return f"Unknown key '{full_key}'; {listed}."


def _below(where: str, name: str) -> str:
    return f"{where}.{name}" if where else name


def _elsewhere(asked: str, root: DictConfig, cutoff: float = 1.0) -> list[str]:
    """Keys at any depth whose end is, or is spelt nearly, as the end of what was asked for: as much of it as fits."""
    keys = list(_keys(root, ""))
    for length in range(asked.count(".") + 1, 0, -1):
        ends = {key: ".".join(key.split(".")[-length:]) for key in keys if key.count(".") + 1 >= length}
        end = ".".join(asked.split(".")[-length:])
        if close := difflib.get_close_matches(end, sorted(set(ends.values())), n=1, cutoff=cutoff):
            return [key for key in keys if ends.get(key) == close[0]]
    return []


def _keys(node: DictConfig, path: str) -> Iterator[str]:
    """Every key below a node, in full; Hydra's own left out."""
    for key in node:
        if str(key).startswith("_") or (not path and key == "hydra"):
            continue
        full = _below(path, str(key))
        yield full
        child = node._get_node(key)  # unresolved: a missing value or an interpolation has no keys of its own
        if isinstance(child, DictConfig) and not child._is_none() and not child._is_missing():
            yield from _keys(child, full)
