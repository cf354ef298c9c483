"""The map that docs/architecture.md draws: what is imported from where, however it is imported."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import grabnet

PACKAGE = Path(grabnet.__file__).parent
MAP = Path(__file__).parents[1] / "docs/architecture.md"
MODULES = {
    ".".join(("grabnet", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
}
# Modules in the package's root: what every room uses.
MAX_ROOT_MODULES = 4
_NAMED = re.compile(r"grabnet(?:\.\w+)+")


def imports(source: str) -> set[str]:
    """Modules of grabnet that a source refers to: by import statements anywhere in it, also within functions and
    TYPE_CHECKING blocks, and by their name in a string that is code (`python -m`, importlib, `_target_`)."""
    tree, found = ast.parse(source), set()
    docstrings = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef))
        and node.body and isinstance(node.body[0], ast.Expr)
    }  # fmt: skip
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {known for alias in node.names if (known := _module(alias.name))}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports are not used"
            found |= {known for alias in node.names if (known := _module(f"{node.module}.{alias.name}"))}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            found |= {known for name in _NAMED.findall(node.value) if (known := _module(name))}
    return found


def _module(name: str) -> str | None:
    """The module that a dotted name is or lies in; None outside of grabnet."""
    while name and name not in MODULES:
        name = name.rpartition(".")[0]
    return name or None


def room(module: str) -> str:
    """The top-level package that a module lies in; a module of the root is one by itself."""
    return ".".join(module.split(".")[:2])


def graph() -> dict[str, set[str]]:
    return {name: imports(path.read_text()) - {name} for name, path in MODULES.items()}


def circles(arrows: dict[str, set[str]]) -> list[list[str]]:
    """Groups of nodes that reach each other (strongly connected components of more than one node)."""
    reached = {node: _reach(node, arrows) for node in arrows}
    groups = {frozenset(other for other in reached[node] if node in reached[other]) | {node} for node in arrows}
    return sorted(sorted(group) for group in groups if len(group) > 1)


def _reach(node: str, arrows: dict[str, set[str]]) -> set[str]:
    seen: set[str] = set()
    front = [node]
    while front:
        for other in arrows.get(front.pop(), ()):
            if other not in seen:
                seen.add(other)
                front.append(other)
    return seen


def room_graph() -> dict[str, set[str]]:
    arrows: dict[str, set[str]] = {}
    for module, others in graph().items():
        arrows.setdefault(room(module), set()).update(room(other) for other in others)
    # The package's own face offers what lies in the rooms, and these do not import it.
    return {here: others - {here, "grabnet"} for here, others in arrows.items() if here != "grabnet"}


def test_imports_are_found_wherever_they_hide():
    source = '''
"""Speaks of grabnet.cli.entry."""
from typing import TYPE_CHECKING
import grabnet.errors
if TYPE_CHECKING:
    from grabnet.geometry import bps
def f():
    """Also of grabnet.io.npz."""
    from grabnet.body.hand import HandModel
    return ["python", "-m", "grabnet.training.run"], f"{1} grabnet.data.frames.Frames"
'''
    assert imports(source) == {
        "grabnet.errors", "grabnet.geometry.bps", "grabnet.body.hand", "grabnet.training.run", "grabnet.data.frames",
    }  # fmt: skip
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == [["b", "c"]]


def test_no_module_imports_one_that_imports_it():
    assert circles(graph()) == []


def test_no_room_imports_one_that_imports_it():
    assert circles(room_graph()) == []


def test_nothing_but_the_package_itself_imports_its_face():
    assert [module for module, others in graph().items() if "grabnet" in others and module != "grabnet"] == []


def test_the_root_stays_small():
    in_root = [name for name, path in MODULES.items() if path.parent == PACKAGE and name != "grabnet"]
    assert len(in_root) <= MAX_ROOT_MODULES, in_root


def rooms() -> dict[str, set[str]]:
    """The map's table: each room, in order, and the rooms that it may import besides io and cli."""
    rows = re.findall(r"^\| `(\w+)/` \| .* \|([^|]*)\|$", MAP.read_text(), re.MULTILINE)
    return {name: {other.strip() for other in imported.split(",") if other.strip()} for name, imported in rows}


def test_the_map_has_the_rooms_that_there_are():
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert set(rooms()) == folders


def test_rooms_import_what_the_map_allows():
    table, arrows = rooms(), room_graph()
    root = {name for name, path in MODULES.items() if path.parent == PACKAGE}
    for name, allowed in table.items():
        above = set(list(table)[: list(table).index(name)])
        assert allowed <= above, f"{name} stands above what its row names"
        imported = {other.removeprefix("grabnet.") for other in arrows.pop(f"grabnet.{name}") - root}
        assert imported <= allowed | ({"io", "cli"} & above), name
    arrows.pop("grabnet.__main__")  # starts the commands
    assert all(others <= root for others in arrows.values()), "modules of the root import no room"


def test_the_map_names_files_that_exist():
    named = set(re.findall(r"`(grabnet/[\w/]+\.py)`", MAP.read_text()))
    assert sorted(path for path in named if not (PACKAGE.parent / path).exists()) == []
