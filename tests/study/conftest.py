"""A small exported study of primitives, with films, and studies without films."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hydra.utils import instantiate

import grabnet.study
from grabnet.cli.entry import compose
from grabnet.study.export import run
from grabnet.study.key import StudyKey
from grabnet.study.simulation import DesignConfig
from grabnet.visual.pictures import can_render

ROOT = Path(__file__).parents[2]
FILM = ["film.size=96", "film.seconds=0.5", "film.supersampling=1"]


@pytest.fixture(scope="session")
def export_study(tiny_dataset, cache_dir) -> Callable[..., Path]:
    """Export a study of recorded and transplanted grasps of the ring, or skip where nothing can be drawn."""
    if (reason := can_render()) is not None:
        pytest.skip(reason)
    data = ["data=frames", f"data.root={tiny_dataset}", "data.split.val=[can]", "data.split.test=[ring]"]
    plain = ["optimise=0", "candidates=1"]  # without rows that the study does not show
    evaluation = ",".join(f"'{v}'" for v in [*data, *plain, f"cache_dir={cache_dir}", f"data.cache_dir={cache_dir}"])
    rows = ["models=[]", "conditions=[Ground truth,Naive baseline]", f"evaluation=[{evaluation}]", "processes=1"]

    def export(output: Path, *values: str) -> Path:
        few = ["n=2", "catches=2", "shown=1", "catches_shown=1", "lists=4", *FILM, f"output={output}"]
        assert run(instantiate(compose("study/export", [*rows, *few, *values]), _convert_="all")) == 0
        return output

    return export


@pytest.fixture(scope="session")
def rating_study(export_study, tmp_path_factory) -> Path:
    """An exported study; not to be written to."""
    return export_study(tmp_path_factory.mktemp("study") / "rating")


@pytest.fixture(scope="session")
def paired_study(export_study, tmp_path_factory) -> Path:
    return export_study(tmp_path_factory.mktemp("study") / "paired", "kind=paired", "completion_code=C0DE")


@pytest.fixture
def copied(tmp_path) -> Callable[[Path], Path]:
    """A copy of a study, to be answered."""
    return lambda study: Path(shutil.copytree(study, tmp_path / study.name))


def made_key(kind: str = "rating", objects: int = 2, n: int = 4, shown: int | None = 2) -> StudyKey:
    """A study without films."""
    design = DesignConfig(kind=kind, objects=objects, n=n, catches=n, shown=shown, catches_shown=shown, lists=6)
    return design.key(5, np.random.default_rng(0))


@pytest.fixture
def unfilmed(tmp_path) -> Path:
    """An export with page and key, but with a text instead of each video."""
    folder = tmp_path / "unfilmed"
    shutil.copytree(Path(grabnet.study.__file__).with_name("page"), folder / "site")
    key = made_key()
    key.write(folder)
    (folder / "site/videos").mkdir()
    for name in key.videos:
        (folder / f"site/videos/{name}.mp4").write_text(name)
    return folder


def record_of(key: StudyKey, number: int, session: int, answer: int = 4) -> dict:
    """A rater's answers, all the same."""
    answers = [{"videos": trial, "answer": answer, "seconds": 1.5} for trial in key.lists[number]]
    return {"study": key.study, "session": f"{session:032x}", "list": number, "platform": {}, "answers": answers}


@contextmanager
def served(folder: Path, *values: str) -> Iterator[tuple[str, subprocess.Popen]]:
    """The address of a server of a study, a process of its own, and the process."""
    command = [sys.executable, "-m", "grabnet", "study", "serve", f"export={folder}", "port=0", *values]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
    with tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True, env=environment)
        try:
            for line in process.stdout:
                if found := re.search(r"https?://[\d.]+:\d+", line):
                    break
            else:
                errors.seek(0)
                raise AssertionError(errors.read())
            yield found[0], process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            process.wait(30)
            process.stdout.close()
