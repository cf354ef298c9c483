"""Every command of the README in the order of the page, as a person types it: read by the command itself, up to the
point where its work begins. `make readme` (tests/readme.py) does the work, too."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest
import trimesh
from hydra.utils import instantiate

from grabnet.cli import entry
from grabnet.commands import COMMANDS, build_open
from grabnet.io.recipes import claim
from tests.readme import ROOT, blocks, commands, words

MODULES = {module.rpartition(".")[2]: module for module, _ in COMMANDS.values()}


@pytest.fixture
def started(monkeypatch):
    """What a command line starts: the name of its command, and the config or arguments that it would work with."""
    works = []

    def hydra_main(**_):
        return lambda job: lambda: works.append("run")

    monkeypatch.setattr(entry.hydra, "main", hydra_main)
    composed = entry._composed

    def remembered(*arguments):
        works.append(composed(*arguments))
        return works[-1]

    monkeypatch.setattr(entry, "_composed", remembered)
    for name in ("hand", "objects", "grasps", "body", "sequences", "film"):
        monkeypatch.setattr(build_open, name, works.append)

    def start(argv: list[str]) -> list:
        """Of a script, or of the program `grabnet`."""
        works.clear()
        is_program = argv[0] == "grabnet"
        monkeypatch.setattr(sys, "argv", argv[1:] if is_program else argv)
        module = COMMANDS[argv[1]][0] if is_program else MODULES[Path(argv[0]).stem]
        assert import_module(module).main() == 0
        return list(works)

    return start


def test_commands_are_found():
    text = "a\n```sh\nls -l   # all\ncp a \\\n  b  # two\n\n# nothing\n```\n```python\nx\n```\n```sh\ngrep '#'\n```\n"
    assert [words(command) for command in commands(text)] == [["ls", "-l"], ["cp", "a", "b"], ["grep", "#"]]
    assert blocks("python", text) == ["x\n"]
    assert len(commands()) > 30


def test_every_command_is_read_as_printed(started, tmp_path, monkeypatch):
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    monkeypatch.chdir(tmp_path)
    for command in commands():
        program, *arguments = words(command)
        if program == "python":
            assert (ROOT / arguments[0]).is_file(), command
            assert started(arguments), command
        elif program == "make":
            subprocess.run(["make", "-n", *arguments], cwd=ROOT, check=True, capture_output=True)
        else:
            (extra,) = re.fullmatch(r"pip install -e '\.\[([\w-]+)\]'", command).groups()
            assert extra in extras, command


@pytest.mark.parametrize("document", sorted((ROOT / "docs").glob("*.md")), ids=lambda path: path.name)
def test_every_command_of_a_document_is_read_as_printed(document, started, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = document.read_text(encoding="utf-8").replace("```\ngrabnet", "```sh\ngrabnet")
    for command in commands(text):
        assert started(words(command)), command


def test_no_recordings_go_into_a_data_set_of_other_settings(started, tmp_path):
    """Each line of the README that makes frames runs after those before it: none meets an output of another recipe."""
    lines = [words(c)[1:] for c in commands() if "scripts/preprocess.py" in c and "data=grab" not in c]
    assert len(lines) >= 6
    for argv in lines:
        config = instantiate(started(argv)[0], _convert_="all")
        claim(tmp_path / config.output / "recipe.json", config.recipe(), f"{argv} needs another output=")


def test_grasps_for_your_own_mesh(tmp_path, monkeypatch, capsys):
    """The first commands that people type are run to their end, after one another, in one folder."""
    monkeypatch.chdir(tmp_path)
    trimesh.creation.cylinder(0.035, 0.1).export("cup.obj")
    (command,) = (words(command)[1:] for command in commands() if "mesh=cup.obj" in command)
    monkeypatch.setattr(sys, "argv", command)
    assert import_module(COMMANDS["sample"][0]).main() == 0
    for block in blocks("python"):
        exec(compile(block, "README.md", "exec"), {})
    assert {"grasps.npz", "grasps.json", "meshes"} <= {path.name for path in Path("grasps/cup").iterdir()}
