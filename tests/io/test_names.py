"""Copies and what systems add never count twice."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from grabnet.io.names import is_copy, is_hidden, originals

COPIES = ["mug (1)", "mug copy", "mug copy 2", "mug - Copy", "mug - Copy (2)", "mug (copy)", "Copy of mug"]
COPIES += ["mug (another copy)", "mug (3rd copy)", "Copy (2) of mug", "mug - Kopie", "mug - Kopie (2)", "Kopie von mug"]
COPIES += ["mug (Ann's conflicted copy 2024-05-01)", "mug conflicted copy", "mug.sync-conflict-20240501-101010-ABCDEFG"]
OTHERS = [
    "mug",
    "mug_pass_1",
    "mug(1)",
    "mug 2",
    "mug_copy_1",
    "copycat",
    "photocopy",
    "grab__s1",
    "mug_kopie",
    "s1 (3rd)",
]


@pytest.mark.parametrize("stem", COPIES)
def test_copies_are_known_by_their_names(stem):
    assert is_copy(f"folder/{stem}.npz")


@pytest.mark.parametrize("stem", OTHERS)
def test_other_names_are_not_copies(stem):
    assert not is_copy(f"Copy of all/{stem}.npz")


def test_hidden_files_are_known_by_any_part_of_their_path():
    assert [
        is_hidden(n) for n in ("._a.npz", "__MACOSX/a", "a/.b/c", ".DS_Store", "a\\._b", "..x.npz", "@eaDir/a")
    ] == [True] * 7
    assert [is_hidden(n) for n in ("a/b", "../a", ".", "./a", "a._b")] == [False] * 5


def test_originals_are_what_is_left_in_order_and_copies_are_told(tmp_path, caplog):
    folder = tmp_path / ".hidden place"
    folder.mkdir()
    for name in ("mug.npz", "cup.npz", "cup (1).npz", "mug 2.npz", "mug(3).npz", "cup 2.ply", "._mug.npz", "jug 2.npz"):
        (folder / name).touch()
    with caplog.at_level(logging.WARNING):
        found = [file.name for file in originals(folder.iterdir(), folder)]
    assert found == ["cup 2.ply", "cup.npz", "jug 2.npz", "mug.npz"], "numbers beside no original stay"
    assert sorted(Path(r.args[0]).name for r in caplog.records) == ["cup (1).npz", "mug 2.npz", "mug(3).npz"]
    (folder / "a\x1b[2J (1).npz").touch()
    originals(folder.iterdir(), folder)
    assert "\\x1b[2J (1).npz is left out" in caplog.text and "\x1b" not in caplog.text
