from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given, settings
from hypothesis import strategies as st

from grabnet.cli.quoting import quoted

HOME = str(Path.home())


def read_back(argument: str):
    """What Hydra makes of the quoted argument."""
    (argument,) = quoted([argument], ["file"], ["mesh"])
    value = OverridesParser.create().parse_override(argument)
    assert not value.is_sweep_override()
    return value.value()


def plain(value) -> str | list[str]:
    return [str(v) for v in value] if isinstance(value, list) else str(value)


@settings(deadline=None, max_examples=40)
@given(st.text(st.characters(codec="utf-8", exclude_characters="\0\n\r,[]'\"{}", exclude_categories=["Cs", "Cc"])))
def test_any_file_name_arrives_as_typed(name):
    name = f"/a{name}b.obj"
    assert plain(read_back(f"mesh={name}")) == name
    assert read_back(f"file={name}") == name
    listed = [f"x{name}", name]
    assert [v.strip() for v in plain(read_back(f"mesh=[{','.join(listed)}]"))] == listed


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("mesh=a.obj", "a.obj"),
        ("mesh=bäll (1).obj", "bäll (1).obj"),
        ("mesh='a,b.obj'", "a,b.obj"),
        ('mesh=q".obj', 'q".obj'),
        ("mesh=C:\\new (2)\\", "C:\\new (2)\\"),
        ("mesh=a.obj,b.ply", ["a.obj", "b.ply"]),
        ("mesh=[a.obj,~/bäll.ply]", ["a.obj", f"{HOME}/bäll.ply"]),
        ("file=a,b (1)", "a,b (1)"),
        ("file=[a]", "[a]"),
        ("file=2024", "2024"),
        ("file=1e-3", "1e-3"),
        ("file=true", "true"),
        ("file=null", "None"),
        ("file=x=1", "x=1"),
        ("file=~/a b", f"{HOME}/a b"),
        ("file=~", HOME),
        ("file=a~b", "a~b"),
        ("file=${seed}/läuf", "${seed}/läuf"),
        ("++file=läuf(1)", "läuf(1)"),
    ],
)
def test_as_people_type(typed, meant):
    assert plain(read_back(typed)) == meant


def test_other_arguments_stay_as_they_are():
    arguments = ["n=1,2", "--multirun", "mesh=a.obj", "seed=(3)", "other=é", "mesh", "~mesh"]
    assert quoted(arguments, ["mesh"]) == arguments


def test_a_sweep_over_files_stays_one():
    arguments = ["-m", "file=a,b", "mesh=ä,b", "file=glob(*)"]
    assert quoted(arguments, ["file"], ["mesh"]) == ["-m", "file=a,b", 'mesh="ä","b"', "file=glob(*)"]


def test_lists_within_a_list_stay():
    """A model of several networks among others."""
    typed = "models=[[runs/a,runs/b],open]"
    assert quoted([typed], [], ["models"]) == [typed]
