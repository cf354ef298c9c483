"""How trainings end: stopped, out of time, beside another one, or with a process that does not answer."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import lightning as L
import pytest
from filelock import FileLock
from lightning.pytorch.callbacks import Timer

from grabnet.cli.entry import compose
from grabnet.errors import UserError
from grabnet.io.locks import LOCK
from grabnet.training.loggers import ID, wandb_logger
from grabnet.training.processes import Lifeline
from grabnet.training.run import train
from tests.processes import start
from tests.tiny import tiny_overrides


class TimeRunsOut(L.Callback):
    """After the first epoch, however long that took."""

    def on_train_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        for timer in trainer.callbacks:
            if isinstance(timer, Timer):
                timer._offset = 1e6


class GetsSigterm(L.Callback):
    """As from a queue, in the second epoch."""

    def on_train_epoch_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        if trainer.current_epoch == 1:
            os.kill(os.getpid(), signal.SIGTERM)


def test_sigterm_ends_a_run_with_143_and_the_same_command_goes_on(tiny_dataset, tmp_path, cache_dir):
    run_dir, output = tmp_path / "run", tmp_path / "output.txt"
    overrides = tiny_overrides(tiny_dataset, run_dir, cache_dir, "coarsenet", "test=false", "callbacks.grasps=null")
    process = start([*overrides, f"+callbacks.ends._target_={__name__}.GetsSigterm"], output)
    process.join()
    assert process.exitcode == 143
    said = f"error: stopped by SIGTERM. The same command goes on from {run_dir}/checkpoints/last.ckpt."
    assert output.read_text().splitlines()[-1] == said
    train(compose("train", overrides))
    assert len(json.loads((run_dir / "history.json").read_text())) == 3


@pytest.mark.parametrize(
    ("more", "ended_by"),
    [
        (
            [
                f"+callbacks.ends._target_={__name__}.TimeRunsOut",
                "trainer.max_time=00:10:00:00",
                "trainer.max_epochs=2",
            ],
            "max_time",
        ),
        (["trainer.max_epochs=1"], "max_epochs"),
        (["+trainer.max_steps=4"], "max_steps"),
        (["callbacks.early_stopping.patience=0", "+callbacks.early_stopping.min_delta=1e9"], "early_stopping"),
    ],
)
def test_what_ended_a_run_is_recorded(more, ended_by, tiny_dataset, tmp_path, cache_dir, caplog):
    overrides = ("test=false", "callbacks.grasps=null", *more)
    train(compose("train", tiny_overrides(tiny_dataset, tmp_path, cache_dir, "coarsenet", *overrides)))
    assert json.loads((tmp_path / "provenance.json").read_text())["ended_by"] == ended_by
    said = "trainer.max_time=00:10:00:00 ended the training in epoch 2 of 2." in caplog.messages
    assert said == (ended_by == "max_time")


def test_a_folder_takes_one_run_at_a_time(tiny_dataset, tmp_path, cache_dir):
    with (
        FileLock(tmp_path / LOCK),
        pytest.raises(UserError, match=r"Another run is at work on .*: wait for it, or choose another run_dir"),
    ):
        train(compose("train", tiny_overrides(tiny_dataset, tmp_path, cache_dir)))
    assert {path.name for path in tmp_path.iterdir()} <= {LOCK}


# The other end of a lifeline, and a watch on it with little patience.
OTHER = "from grabnet.training.processes import lifeline_of_child; import time; lifeline_of_child(); time.sleep(60)"
WATCHES = """
import subprocess, sys, threading, time
from grabnet.training.processes import Lifeline, _watch
other = subprocess.Popen([sys.executable, "-c", {other!r}], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
print(other.pid, flush=True)
line = Lifeline(other.stdout.fileno(), other.stdin.fileno())
while line.heard > time.monotonic():
    time.sleep(0.1)
print("heard", flush=True)
_watch([other], [line], threading.Event(), silence=3)
"""


def test_a_process_that_stops_answering_ends_the_others():
    root = Path(__file__).parents[2]
    environment = os.environ | {"PYTHONPATH": str(root)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    watch = [sys.executable, "-c", WATCHES.format(other=OTHER)]
    process = subprocess.Popen(watch, cwd=root, env=environment, text=True, **pipes)
    other = int(process.stdout.readline())
    assert process.stdout.readline() == "heard\n"
    os.kill(other, signal.SIGSTOP)
    _, said = process.communicate(timeout=60)
    sentence = "A process of the run gave no sign of life for 3 s: the run cannot go on."
    assert process.returncode == 2 and said == f"error: {sentence}\n"
    for _ in range(200):
        if not Path(f"/proc/{other}").exists() or "Z" in Path(f"/proc/{other}/stat").read_text():
            break
        time.sleep(0.05)
    else:
        raise AssertionError("the other process is still there")


def test_a_lifeline_hears_and_notices_the_end():
    (first_in, second_out), (second_in, first_out) = os.pipe(), os.pipe()
    line = Lifeline(first_in, first_out)
    due = line.heard
    os.write(second_out, b".")
    assert os.read(second_in, 1) == b"."  # it speaks, too
    for _ in range(100):
        if line.heard != due:
            break
        time.sleep(0.05)
    assert line.heard < due and not line.closed
    os.close(second_out)
    for _ in range(100):
        if line.closed:
            break
        time.sleep(0.05)
    assert line.closed


def test_wandb_goes_on_with_the_same_run(tmp_path):
    first, again, anew = (wandb_logger(str(tmp_path), resume, offline=True) for resume in (True, True, False))
    assert first.version == again.version == first._wandb_init["id"] != anew.version
    assert (tmp_path / ID).read_text() == anew.version
    assert first._wandb_init["resume"] == "allow" and first._wandb_init["group"] is None
