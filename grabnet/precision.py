"""Keeping lengths and angles exact where a network runs in half precision."""

from __future__ import annotations

import functools
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import torch


def full_precision(function: Callable[..., Any]) -> Callable[..., Any]:
    """Run a function outside autocast, its products exact whatever `matmul_precision` is.

    Products of bf16 are off by .4 %, which on a hand is half a millimetre.
    """

    @functools.wraps(function)
    def exact(*arguments: Any, **options: Any) -> Any:
        with ExitStack() as stack:
            stack.callback(torch.set_float32_matmul_precision, torch.get_float32_matmul_precision())
            torch.set_float32_matmul_precision("highest")
            for device in ("cpu", "cuda"):
                if torch.is_autocast_enabled(device):
                    stack.enter_context(torch.autocast(device, enabled=False))
            return function(*arguments, **options)

    return exact


def single_by_default(function: Callable[..., Any]) -> Callable[..., Any]:
    """Run a function with float32 as torch's default, which a program may have changed: the networks are trained so."""

    @functools.wraps(function)
    def single(*arguments: Any, **options: Any) -> Any:
        before = torch.get_default_dtype()
        torch.set_default_dtype(torch.float32)
        try:
            return function(*arguments, **options)
        finally:
            torch.set_default_dtype(before)

    return single
