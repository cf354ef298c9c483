"""The median rule, and a real run that it ends."""

from __future__ import annotations

import math

import pytest

from grabnet.cli.entry import compose
from grabnet.io.files import write_json
from grabnet.sweeps.pruning import MedianPruning
from grabnet.training.ending import RunPruned
from grabnet.training.history import HISTORY
from grabnet.training.run import train
from tests.tiny import tiny_overrides


def epochs(*losses: float) -> list[dict[str, float]]:
    return [{"epoch": i, "val/loss": loss} for i, loss in enumerate(losses)]


OTHERS = [epochs(5, 3, 1), epochs(5, 4, 1), epochs(5, 5)]  # best after two epochs: 3, 4, 5


@pytest.mark.parametrize(
    ("own", "pruned"),
    [
        (epochs(9), False),  # too early
        (epochs(9, 4), False),  # the median itself
        (epochs(9, 4.1), True),
        (epochs(4, 9), False),  # its best counts, not its last
        (epochs(9, 9, 0.5), False),  # only two others have come as far as three epochs
        (epochs(math.nan, math.nan), True),
    ],
)
def test_worse_than_the_median_of_those_that_came_as_far(own, pruned):
    rule = MedianPruning(siblings="unused", objective="val/loss", min_epochs=2, min_siblings=3)
    assert bool(rule.verdict(own, OTHERS)) == pruned


def test_a_hopeless_run_ends_at_its_second_epoch(tiny_dataset, tmp_path, cache_dir):
    for name in "abc":
        write_json(tmp_path / name / HISTORY, epochs(0.1, 0.1))
    more = ("callbacks=pruning", "callbacks.pruning.min_epochs=2", "callbacks.pruning.min_siblings=3")
    overrides = [*tiny_overrides(tiny_dataset, tmp_path / "own", cache_dir), *more, f"sweep_dir={tmp_path}"]
    with pytest.raises(RunPruned, match=r"val/loss is .* after 2 epochs; the median of 3 other runs is 0\.1\."):
        train(compose("train", [o for o in overrides if o != "callbacks.progress_bar=null"]))
