"""Commands of commands: `grabnet study serve`, `grabnet mosh place`."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Callable, Mapping

from grabnet.cli.ends import say
from grabnet.cli.help import EXIT_CODES


def choose(
    program: str, commands: Mapping[str, Callable[[], int]], about: str, default: Callable[[], int] | None = None
) -> int:
    """Run the command that the first argument names, on the arguments after it.

    Args:
        program: whose commands they are, as in "study".
        commands: by name; each reads the command line and returns the exit code.
        about: what `--help` prints where no command is named.
        default: what is run where the first argument is no command's name, nor like one.

    Returns:
        the command's exit code; 2 where there is no such command.
    """
    name, *arguments = sys.argv[1:] or ["--help"]
    if name in commands:
        sys.argv = [f"grabnet {program} {name}", *arguments]
        return commands[name]()
    close = [] if "=" in name else difflib.get_close_matches(name, commands, n=1)
    if default is not None and not close:
        return default()
    if name in ("--help", "-h"):
        print(f"{about}\n{EXIT_CODES}")
        return 0
    if name in ("-sc", "--shell-completion"):
        print(" ".join(commands))
        return 0
    hint = f"did you mean {close[0]}?" if close else f"it can be {', '.join(commands)}."
    say(f"There is no command '{program} {name}'; {hint}")
    return 2
