"""From recordings to a data set, as the command does it."""

from __future__ import annotations

import json

from hydra.utils import instantiate

from grabnet.cli import compose
from grabnet.data.frames import FramesStore
from tests.preprocess.tiny_grab import SEQUENCES, overrides


def make(grab, output, cache_dir, *more):
    """Run with these values; recordings that failed."""
    wanted = instantiate(compose("preprocess/preprocess", overrides(*grab, output, cache_dir, *more)), _convert_="all")
    return {outcome.name: outcome.failure for outcome in wanted.run()}


def test_recordings_become_a_data_set(grab, tmp_path, cache_dir):
    assert make(grab, tmp_path, cache_dir, "pictures=true") == {}
    store = FramesStore.load(tmp_path / "frames")
    assert store.sequences == sorted(SEQUENCES)
    json.loads((tmp_path / "card.json").read_text())
    print((tmp_path / "card.md").read_text())
    print((tmp_path / "waterfall.csv").read_text())
    print((tmp_path / "run.json").read_text())
