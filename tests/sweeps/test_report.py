"""What is told of runs that were not all made alike."""

from __future__ import annotations

import csv

from grabnet.io.files import write_json
from grabnet.sweeps.report import report
from grabnet.sweeps.runs import Run
from grabnet.training.history import HISTORY


def test_runs_of_a_space_that_was_changed_stand_in_one_table(tmp_path):
    spaces = [{"width": "16", "lr": "0.1"}, {"width": "32"}, {"lr": "0.2", "name": "b"}]
    runs = [Run(tmp_path / f"trial_{k}", (), values) for k, values in enumerate(spaces)]
    for k, run in enumerate(runs):
        write_json(run.folder / HISTORY, [{"epoch": 0, "seconds": 1.0, "val/loss": 3.0 - k}])
    report(runs, "val/loss", tmp_path)
    with (tmp_path / "sweep.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [{name: row[name] for name in ("width", "lr", "name") if row[name]} for row in rows] == spaces
    assert [row["val/loss"] for row in rows] == ["3.0", "2.0", "1.0"]
    assert (tmp_path / "sweep.png").exists()
