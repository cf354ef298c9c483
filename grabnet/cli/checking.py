"""Check a composed config against the code it configures, before anything is built."""

from __future__ import annotations

import collections.abc
import inspect
import math
import pydoc
import types
import typing
from dataclasses import is_dataclass
from typing import Any

from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import DictConfig, ListConfig, OmegaConf

from grabnet.cli.checks import annotations, mismatch
from grabnet.cli.ends import as_user_error
from grabnet.errors import UserError

_RESERVED = {"_target_", "_partial_", "_recursive_", "_convert_"}


def check(cfg: DictConfig) -> None:
    """Raise a `UserError` for the first value that the class or function it is meant for would not take.

    Every node with a `_target_` is compared with that target's signature: unknown names, and values whose type or range
    (`grabnet.cli.checks`) the annotation excludes. Every number must be finite. Then the config's own class, where it
    names one, is made once: its constructor checks what depends on several values.
    """
    missing = OmegaConf.missing_keys(cfg)
    if missing:
        raise UserError(f"The config value {sorted(missing)[0]} must be given on the command line.")
    _walk(cfg, "")
    if "_target_" in cfg:
        try:
            instantiate(cfg, _convert_="all")
        except InstantiationException as error:
            raise refusal(error) or error from None


def refuse_removal(cfg: DictConfig, key: str) -> None:
    """Raise a `UserError` where the value at `key`, which the command line removed, is one that must be given."""
    where, _, name = key.rpartition(".")
    node = OmegaConf.select(cfg, where) if where else cfg
    if isinstance(node, DictConfig) and "_target_" in node:
        parameter = inspect.signature(_located(node["_target_"], where)).parameters.get(name)
        if parameter is not None and parameter.default is parameter.empty:
            raise UserError(f"~{key} removes what {node['_target_']} needs: give it another value instead.")


def refusal(error: InstantiationException) -> UserError | None:
    """What a constructor refused, which Hydra passes on, in a sentence; None where it failed for another reason."""
    cause = error.__cause__
    if isinstance(cause, UserError):
        return cause
    if not isinstance(cause, ValueError | TypeError):
        return None
    _, known, key = str(error).rpartition("full_key: ")
    return UserError(f"{key}: " * bool(known) + " ".join(str(cause).split()))


def _walk(node: Any, path: str) -> None:
    if isinstance(node, ListConfig):
        for i, child in enumerate(node):
            _walk(child, f"{path}[{i}]")
    elif isinstance(node, DictConfig):
        if "_target_" in node:
            _check_target(node, path)
        for key in node:
            _walk(node[key], _joined(path, key))
    elif isinstance(node, float) and not math.isfinite(node):
        raise UserError(f"{path} is {node}; it must be a finite number.")


def _check_target(node: DictConfig, path: str) -> None:
    target = _located(node["_target_"], path)
    signature = inspect.signature(target)
    parameters = {n: p for n, p in signature.parameters.items() if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)}
    takes_any = len(parameters) < len(signature.parameters)
    given = [k for k in node if k not in _RESERVED]
    if unknown := [k for k in given if k not in parameters and not takes_any]:
        raise UserError(f"{path or 'The config'} has no value {unknown[0]}; it takes {', '.join(parameters)}.")
    try:
        marked = annotations(target)
        hints = typing.get_type_hints(
            target if is_dataclass(target) or not inspect.isclass(target) else target.__init__
        )
    except (NameError, TypeError):  # a library whose annotations only a type checker can resolve
        return
    for key in given:
        value, name = node[key], _joined(path, key)
        if key not in hints:
            continue
        if not isinstance(value, DictConfig):
            if not _fits(value, hints[key]):
                raise UserError(f"{name}={_shown(value)} is of the wrong type: it must be {_in_words(hints[key])}.")
            if found := mismatch(value, marked[key]):
                raise UserError(f"{name} is {found[0]!r}; it {found[1]}.")
        elif typing.get_origin(hints[key]) is dict:
            for child, item in ((child, value[child]) for child in value):
                if not isinstance(item, DictConfig) and not _fits(item, hint := typing.get_args(hints[key])[1]):
                    words = _in_words(hint)
                    raise UserError(f"{name}.{child}={_shown(item)} is of the wrong type: it must be {words}.")
        elif "_target_" in value:
            made, expected = _located(value["_target_"], name), _made(hints[key], bool(value.get("_partial_")))
            if expected is not Any and all(map(inspect.isclass, (made, expected))) and not issubclass(made, expected):
                raise UserError(f"{name} makes a {made.__name__}; a {expected.__name__} belongs there.")


def _joined(path: str, key: object) -> str:
    return f"{path}.{key}".lstrip(".")


def _located(target: str, path: str) -> Any:
    """What a `_target_` names. (Hydra's own look-up writes to the log what it does not find.)

    Raises:
        UserError: it does not exist or cannot be imported. What stops the command while it imports, as `Stopped` does,
            is raised as it is, though pydoc wraps it.
    """
    try:
        found = pydoc.locate(target)
    except pydoc.ErrorDuringImport as error:
        if not isinstance(error.value, Exception):
            raise error.value from None
        refused = UserError(f"{path}._target_={target} cannot be imported ({error.value}).")
        raise (as_user_error(error.value) or refused) from None
    if found is None:
        raise UserError(f"{path}._target_={target} does not exist.")
    return found


def _made(hint: Any, partial: bool) -> Any:
    """The class of which an argument annotated so, or what it makes when called, is an instance."""
    if not partial:
        return hint
    is_callable = typing.get_origin(hint) is collections.abc.Callable
    return typing.get_args(hint)[1] if is_callable and typing.get_args(hint) else None


def _fits(value: Any, hint: Any) -> bool:
    """Whether a plain config value can stand for the annotation."""
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, option) for option in typing.get_args(hint))
    if origin is typing.Literal:
        return value in typing.get_args(hint)
    if hint is type(None) or value is None:
        return value is None and hint in (type(None), Any, object)
    if hint is float:
        return isinstance(value, float | int) and not isinstance(value, bool)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if origin in (list, tuple, collections.abc.Sequence) or hint in (list, tuple):
        return isinstance(value, ListConfig) and _items_fit(list(value), origin, typing.get_args(hint))
    if origin in (collections.abc.Callable, dict):
        return False
    if origin is not None or not inspect.isclass(hint):
        return True
    if hint.__module__.startswith("pathlib"):
        return isinstance(value, str)
    try:
        return isinstance(value, hint)
    except TypeError:  # a protocol that only a type checker can compare with
        return True


def _items_fit(items: list[Any], origin: Any, hints: tuple[Any, ...]) -> bool:
    """Whether the items of a list can stand for those of the annotation."""
    if origin is tuple and Ellipsis not in hints:
        return len(items) == len(hints) and all(map(_fits, items, hints))
    return not hints or all(_fits(item, hints[0]) for item in items)


def _shown(value: Any) -> str:
    """A value as one types it."""
    if value is None:
        return "null"
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _in_words(hint: Any) -> str:
    """An annotation as one reads it in a config."""
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        words = (word for option in typing.get_args(hint) for word in _in_words(option).split(" or "))
        return " or ".join(dict.fromkeys(words))
    if origin is typing.Literal:
        return " or ".join(map(str, typing.get_args(hint)))
    if origin is tuple and Ellipsis not in typing.get_args(hint):
        return f"a list of {len(typing.get_args(hint))} values"
    if origin in (list, tuple, collections.abc.Sequence) or hint in (list, tuple):
        kinds = {bool: "truth values", str: "strings", int: "ints", float: "numbers"}
        return f"a list of {kind}" if (kind := kinds.get(next(iter(typing.get_args(hint)), None))) else "a list"
    if origin in (collections.abc.Callable, dict):
        return "a config with a _target_"
    if hint is type(None):
        return "null"
    return {bool: "true or false", str: "a string", int: "an int", float: "a float"}.get(hint) or (
        hint.__name__ if inspect.isclass(hint) else str(hint)
    )
