"""What killed processes leave is cleared by the next start; what is in use, or anyone else's, stays."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from grabnet.io.files import filling, replacing
from grabnet.io.litter import clear_litter

_WRITER = """
import sys, time
from grabnet.io.files import filling, replacing
with {how} as temporary:
    ({file}).write_text("half")
    print("writing", flush=True)
    time.sleep(600)
"""


def _writing(how: str, file: str) -> subprocess.Popen:
    """A process that is in the middle of writing."""
    code = _WRITER.format(how=how, file=file)
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "writing\n"
    return process


def _kill(process: subprocess.Popen) -> None:
    process.send_signal(signal.SIGKILL)
    process.wait()


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_half_written_files_of_killed_processes_are_cleared_and_those_in_use_are_not(tmp_path):
    how, file = f"replacing({str(tmp_path / 'best.ckpt')!r})", "temporary"
    killed, at_work = _writing(how, file), _writing(how, file)
    try:
        _kill(killed)
        assert len(_names(tmp_path)) == 2
        clear_litter(tmp_path, "last.ckpt")
        assert len(_names(tmp_path)) == 2
        clear_litter(tmp_path, "*.ckpt")
        assert len(_names(tmp_path)) == 1, "of the one that is at work"
    finally:
        _kill(at_work)
    clear_litter(tmp_path, "best.ckpt")
    assert _names(tmp_path) == []


def test_a_half_filled_folder_is_cleared_by_the_next_that_fills_it(tmp_path):
    _kill(
        _writing(f"filling({str(tmp_path / 'bowl')!r}, ('grasps.json',), lambda _: True)", "temporary / 'grasps.json'")
    )
    assert len(_names(tmp_path)) == 1
    with filling(tmp_path / "bowl", ("grasps.json",), lambda _: True) as temporary:
        (temporary / "grasps.json").write_text("{}")
    assert _names(tmp_path) == ["bowl"] and _names(tmp_path / "bowl") == ["grasps.json"]


OTHERS = [".best-short.ckpt", ".best-abcdefgh.txt", ".best-ABCDEFGH.ckpt", ".worse-abcdefgh.ckpt", "best-abcdefgh.ckpt"]


@pytest.mark.parametrize("name", OTHERS)
def test_other_files_stay(tmp_path, name):
    (tmp_path / name).touch()
    clear_litter(tmp_path, "best.ckpt")
    assert _names(tmp_path) == [name]


def test_a_folder_of_something_else_stays(tmp_path):
    mine = tmp_path / ".bowl-abcdefgh"
    mine.mkdir()
    (mine / "thesis.tex").touch()
    clear_litter(tmp_path, "bowl", contents=("grasps.json",))
    assert (mine / "thesis.tex").exists()
    (mine / "thesis.tex").rename(mine / "grasps.json")
    clear_litter(tmp_path, "bowl")
    assert mine.exists(), "nothing is known of its contents"
    clear_litter(tmp_path, "bowl", contents=("grasps.json",))
    assert not mine.exists()


def test_links_are_not_followed(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "grasps.json").touch()
    (tmp_path / ".bowl-abcdefgh").symlink_to(tmp_path / "mine")
    clear_litter(tmp_path, "bowl", contents=("grasps.json",))
    assert (tmp_path / "mine" / "grasps.json").exists()


def test_names_with_special_letters_are_found(tmp_path):
    path = tmp_path / "a[1].b ü.npz"
    _kill(_writing(f"replacing({str(path)!r})", "temporary"))
    clear_litter(tmp_path, path.name)
    assert _names(tmp_path) == []
    with replacing(path) as temporary:
        temporary.write_text("x")
    assert _names(tmp_path) == [path.name]
