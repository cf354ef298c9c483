"""Progress and the time left: bars on a terminal, lines elsewhere, nothing when quiet or without a command."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path

import pytest
from rich.progress import Progress

from grabnet.cli import progress
from grabnet.cli.parsed import make_parser, run_parsed
from grabnet.cli.progress import duration, line, shown, steps, track

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def soon(monkeypatch):
    """Lines come every few milliseconds."""
    monkeypatch.setattr(progress, "_FIRST", 0.005)
    monkeypatch.setattr(progress, "_EVERY", 0.005)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0, "0 s"), (0.4, "0 s"), (59.4, "59 s"), (59.6, "1 min"), (61, "1 min 1 s"), (3599.6, "1 h"),
        (3600 + 61, "1 h 1 min"), (7200 + 30, "2 h"), (86400, "24 h"),
    ],
)  # fmt: skip
def test_durations_in_words(seconds, words):
    assert duration(seconds) == words


def test_a_line_says_how_far_it_is_and_how_long_it_takes():
    now = [0.0]
    bars = Progress(disable=True, get_time=lambda: now[0], speed_estimate_period=progress._PERIOD)
    bars.add_task("Drawing [grasps]", total=20, completed=4, about="")  # 4 were there already
    assert line(bars.tasks[0]) == "Drawing [grasps]: 4 of 20"
    for now[0] in (120.0, 240.0, 360.0):
        bars.update(0, advance=2, about="mug")
    assert line(bars.tasks[0]) == "Drawing [grasps]: 10 of 20, 10 min left (mug)"  # the other ten, a minute each
    bars.add_task("Counting", total=None, completed=7, about="")
    assert line(bars.tasks[1]) == "Counting: 7"


def until(lines: list[str], capfd) -> None:
    """Wait for these lines on stderr, in their order."""
    for _ in range(2000):
        said = capfd.readouterr()
        assert not said.out
        for text in said.err.splitlines():
            if lines and text == lines[0]:
                del lines[0]
        if not lines:
            return
        time.sleep(0.005)
    raise AssertionError(lines)


def test_work_within_work_is_told_in_lines(capfd):
    with shown():
        for name in track(["a", "b"], "Meshes"):
            with steps("Grasps", 3, done=1) as counted:
                counted.advance(about=name)
                until([f"Meshes: {'ab'.index(name)} of 2", f"Grasps: 2 of 3 ({name})"], capfd)
        time.sleep(0.05)
        capfd.readouterr()
        time.sleep(0.05)
        assert capfd.readouterr().err == ""  # nothing goes on


def test_a_failure_ends_what_is_shown(capfd):
    with shown():
        with pytest.raises(ZeroDivisionError):
            for k in track(range(3), "Steps"):
                1 / k
        with steps("Others", None):
            until(["Others: 0"], capfd)
    time.sleep(0.05)
    capfd.readouterr()
    time.sleep(0.05)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("block", [lambda: shown(quiet=True), nullcontext])
def test_nothing_is_shown_when_quiet_or_outside_of_commands(block, capfd):
    with block():
        assert list(track(iter("abc"), "Letters")) == ["a", "b", "c"]
        with steps("Steps", 3) as counted:
            counted.advance()
            time.sleep(0.05)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("arguments", [["--quiet", "make"], ["make", "--quiet"], ["make"]])
def test_commands_without_a_config_take_quiet(arguments, monkeypatch, capfd):
    parser = make_parser("Make.")
    command = parser.add_subparsers(required=True).add_parser("make")
    command.set_defaults(call=lambda _: [time.sleep(0.05) for _ in track(range(3), "Making")] and 0)
    monkeypatch.setattr(sys, "argv", ["it", *arguments])
    assert run_parsed(parser) == 0
    assert ("Making: " in capfd.readouterr().err) is ("--quiet" not in arguments)


def test_a_terminal_gets_bars_and_a_pipe_beside_it_only_what_is_printed():
    code = """
import time
from grabnet.cli.progress import shown, track
with shown():
    for k in track(range(5), "Things"):
        print(f"thing {k}", flush=True)
        time.sleep(0.15)
"""
    terminal, end = pty.openpty()
    environment = os.environ | {"PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "100"}
    done = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=end, env=environment, text=True)
    os.close(end)
    seen = os.read(terminal, 1 << 16).decode()
    os.close(terminal)
    assert done.returncode == 0 and done.stdout == "".join(f"thing {k}\n" for k in range(5))
    assert re.search(r"Things .*[1-4]/5.*left:.*0:00:0", seen)
    assert "thing 1" not in seen
