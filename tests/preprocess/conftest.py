from __future__ import annotations

from pathlib import Path

import pytest

from tests.preprocess.tiny_grab import make, write_grab


@pytest.fixture(scope="session")
def grab(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A root in GRAB's layout and a folder of models; not to be written to."""
    root, models = tmp_path_factory.mktemp("grab"), tmp_path_factory.mktemp("models")
    write_grab(root, models)
    return root, models


@pytest.fixture(scope="session")
def made(grab: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory, cache_dir: Path) -> Path:
    """The data set of these recordings, made by one process without interruption; not to be written to."""
    output = tmp_path_factory.mktemp("made")
    assert make(grab, output, cache_dir) == {}
    return output
