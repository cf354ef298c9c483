"""What a result was made with: recorded beside every output."""

from __future__ import annotations

import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = ("grabnet", "torch", "lightning", "hydra-core", "numpy", "warp-lang", "roma", "trimesh", "mujoco", "coacd")


def provenance(**facts: Any) -> dict[str, Any]:
    """Time, versions, machine and commit, and the caller's own facts."""
    return {
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": versions(),
        "machine": f"{platform.system()} {platform.machine()}",
        "commit": _commit(),
    } | facts


def versions() -> dict[str, str | None]:
    """Of Python and the packages that results depend on."""
    return {"python": platform.python_version()} | {name: _version(name) for name in PACKAGES}


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _commit() -> str | None:
    """The checkout's commit, with a + when files differ from it; nothing for an installed package."""
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty=+", "--abbrev=12", "--exclude=*"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return described.stdout.strip()
