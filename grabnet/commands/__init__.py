"""The command `grabnet`: its commands, a module each, and the choice among them."""

from __future__ import annotations

import difflib
import os
import sys
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version

from grabnet.cli.ends import in_sentences, say

# Command: module, and what it does. Each module has a `main()` that reads the command line and returns the exit code;
# only the chosen one is imported.
COMMANDS = {
    "sample": ("grabnet.commands.sample", "draw grasps of your meshes"),
    "train": ("grabnet.commands.train", "train a network, or sweep over trainings"),
    "evaluate": ("grabnet.commands.evaluate", "measure grasps by the protocols of the paper and the field"),
    "study": ("grabnet.commands.study", "let people judge grasps: export, serve, analyse, simulate, power"),
    "preprocess": ("grabnet.commands.preprocess", "make training frames of recordings"),
    "analyze": ("grabnet.commands.analyze", "make the paper's statistics and figures of a data set"),
    "meshes": ("grabnet.commands.meshes", "write meshes of a recording over time, as film, animation or files"),
    "mosh": ("grabnet.commands.mosh", "make recordings of motion-capture markers"),
    "unpack": ("grabnet.commands.unpack_grab", "unpack the zip files of GRAB or of the GrabNet data"),
    "import": ("grabnet.commands.import_checkpoint", "convert a published checkpoint"),
    "build": ("grabnet.commands.build_open", "build the open hand, body, objects, grasps and recordings"),
    "ship": ("grabnet.commands.ship_weights", "make a small copy of a trained network to pass on"),
    "benchmark": ("grabnet.commands.benchmark", "time the code against plainer baselines"),
}


def main() -> int:
    """Run the command that the first argument names, on the arguments after it.

    Returns:
        the command's exit code; 2 where there is no such command.
    """
    name, *arguments = sys.argv[1:] or ["--help"]
    if name in ("-sc", "--shell-completion"):
        # Completion knows programs, not their commands: the line that is typed says which command is meant.
        program, *words = os.environ.get("COMP_LINE", "").split(" ")
        if arguments == ["query=bash"] and len(words) < 2:
            print(" ".join(COMMANDS))
            return 0
        arguments = [name, *arguments]
        name, *words = words or ["train"]
        os.environ["COMP_LINE"] = " ".join([program, *words])
    if name in ("--help", "-h", "help"):
        print(_help())
        return 0
    if name == "--version":
        print(f"grabnet {_version()}")
        return 0
    if name not in COMMANDS:
        close = difflib.get_close_matches(name, COMMANDS, n=1)
        hint = f"did you mean {close[0]}?" if close else f"it can be {', '.join(COMMANDS)}."
        say(f"There is no command '{name}'; {hint}")
        return 2
    sys.argv = [f"grabnet {name}", *arguments]
    return run(name)


def run(name: str) -> int:
    """Run the command of this name on the command line's arguments, and return its exit code."""
    with in_sentences():  # around the imports, too, which take seconds
        return import_module(COMMANDS[name][0]).main()


def _help() -> str:
    from grabnet.cli.help import EXIT_CODES

    lines = [f"  {name:<12}{about}" for name, (_, about) in COMMANDS.items()]
    usage = "usage: grabnet COMMAND [arguments]; grabnet COMMAND --help explains a command's values"
    return "\n".join([usage, "", *lines, "", EXIT_CODES])


def _version() -> str:
    try:
        return version("grabnet")
    except PackageNotFoundError:
        return "(not installed)"
