"""Command lines of analyses of a tiny root."""

from __future__ import annotations

import sys
from pathlib import Path

from hydra.utils import instantiate

from grabnet.cli.entry import compose
from grabnet.commands import run


def values(grab, output: Path, *more: str) -> list[str]:
    root, models = grab
    return [
        "data=grab", f"data.root={root}", f"data.models={models}", f"output={output}", "workers=1",
        "rules.min_body_vertices=1", "rules.posed_every=3", "rules.clusters=2", *more,
    ]  # fmt: skip


def command(monkeypatch, name: str, given: list[str]) -> int:
    monkeypatch.setattr(sys, "argv", [f"grabnet {name}", *given])
    return run(name)


def data_of(grab, tmp_path):
    return instantiate(compose("analyze/analyze", values(grab, tmp_path)), _convert_="all")
