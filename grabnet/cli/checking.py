"""Checking a composed config against the code it configures, before anything is built."""

from __future__ import annotations

import inspect
import pydoc
import types
import typing
from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf

from grabnet.errors import UserError

_RESERVED = {"_target_", "_partial_", "_recursive_", "_convert_"}


def check(cfg: DictConfig) -> None:
    """Raise a `UserError` for the first value that the class or function it is meant for would not take.

    Every node with a `_target_` is held against that target's signature: unknown names, and values whose type the
    annotation excludes.
    """
    missing = OmegaConf.missing_keys(cfg)
    if missing:
        raise UserError(f"The config value {sorted(missing)[0]} must be given on the command line.")
    _walk(cfg, "")


def _walk(node: Any, path: str) -> None:
    if isinstance(node, ListConfig):
        for i, child in enumerate(node):
            _walk(child, f"{path}[{i}]")
    elif isinstance(node, DictConfig):
        if "_target_" in node:
            _check_target(node, path)
        for key in node:
            _walk(node[key], f"{path}.{key}".lstrip("."))


def _check_target(node: DictConfig, path: str) -> None:
    target = _located(node["_target_"], path)
    signature = inspect.signature(target)
    parameters = {n: p for n, p in signature.parameters.items() if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)}
    takes_any = len(parameters) < len(signature.parameters)
    given = [k for k in node if k not in _RESERVED]
    if unknown := [k for k in given if k not in parameters and not takes_any]:
        raise UserError(f"{path} has no value {unknown[0]}; it takes {', '.join(parameters)}.")
    try:
        hints = typing.get_type_hints(target.__init__ if inspect.isclass(target) else target)
    except (NameError, TypeError):  # a library whose annotations only a type checker can resolve
        return
    for key in given:
        value = node[key]
        if key in hints and not isinstance(value, DictConfig) and not _fits(value, hints[key]):
            wanted = getattr(hints[key], "__name__", str(hints[key]))
            name = f"{path}.{key}".lstrip(".")
            raise UserError(f"{name}={value!r} is of the wrong type: {wanted} is wanted.")


def _located(target: str, path: str) -> Any:
    """What a `_target_` names. (Hydra's own look-up writes to the log what it does not find.)"""
    try:
        found = pydoc.locate(target)
    except pydoc.ErrorDuringImport as error:
        raise UserError(f"{path}._target_={target} cannot be imported ({error.value}).") from None
    if found is None:
        raise UserError(f"{path}._target_={target} does not exist.")
    return found


def _fits(value: Any, hint: Any) -> bool:
    """Whether a config value can stand for the annotation; annotations other than plain types fit anything."""
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, option) for option in typing.get_args(hint))
    if hint is type(None):
        return value is None
    if hint is float:
        return isinstance(value, float | int) and not isinstance(value, bool)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if hint in (bool, str):
        return isinstance(value, hint)
    if origin in (list, tuple, typing.Sequence) or hint in (list, tuple):
        return isinstance(value, ListConfig)
    if inspect.isclass(hint) and hint.__module__ == "pathlib":
        return isinstance(value, str)
    return True
