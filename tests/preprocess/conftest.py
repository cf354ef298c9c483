from __future__ import annotations

from pathlib import Path

import pytest

from tests.preprocess.tiny_grab import write_grab


@pytest.fixture(scope="session")
def grab(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A root in GRAB's layout and a folder of models; not to be written to."""
    root, models = tmp_path_factory.mktemp("grab"), tmp_path_factory.mktemp("models")
    write_grab(root, models)
    return root, models
