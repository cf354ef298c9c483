"""State files of any content end in a value of its kind or in a sentence that names file, key and value."""

from __future__ import annotations

import os

import pytest
from omegaconf import OmegaConf

from grabnet.errors import UserError, printable
from grabnet.io.state import Finite, read_config, read_json

CARD = {"format": int, "names": [str], "hash?": (str, None), "counts": {str: Finite(0)}, "status": {"done", "failed"}}
WHOLE = '{"format": 4, "names": ["a"], "counts": {"x": 1.5}, "status": "done", "more": [{}]}'


def _read(tmp_path, text, kind=CARD):
    (tmp_path / "card.json").write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_json(tmp_path / "card.json", kind, "delete it")


def test_a_value_of_its_kind_is_read(tmp_path):
    assert _read(tmp_path, WHOLE)["names"] == ["a"]
    assert _read(tmp_path, WHOLE.replace('"status"', '"hash": null, "status"'))["hash"] is None
    assert _read(tmp_path, '[{"epoch": 1, "loss": NaN}]', [{"epoch": int, "*": float}])[0]["epoch"] == 1


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("4", "null", r"format is null, expected a whole number"),
        ("4", "4.0", r"format is 4\.0"),
        ("4", "true", r"format is true"),
        ("4", "1" + "0" * 30, r"format is 10+, expected a whole number"),
        ("4", "1" + "0" * 5000, "Exceeds the limit|integer"),
        ('["a"]', '"a"', r'names is "a", expected a list'),
        ('["a"]', "[1]", r"names\[0\] is 1, expected text"),
        ('["a"]', r'["\ud800"]', r"names\[0\] is .*expected text"),
        ("1.5", "NaN", r"counts\.x is NaN, expected a number of at least 0"),
        ("1.5", "-1", r"counts\.x is -1"),
        ("1.5", "1e999", r"counts\.x is Infinity"),
        ('"done"', '"\x1b[31m"', "Invalid control character|status is"),
        ('"done"', r'"\u001b[31m"', r'status is .*, expected done or failed'),
        ('"done"', "[]", r"status is \[\]"),
        ('"format": 4, ', "", "it has no format"),
        (WHOLE, "[]", r"its content is \[\], expected an object"),
        (WHOLE, "", "Expecting value"),
        (WHOLE, "{" * 100_000, "RecursionError|Expecting property"),
        ("[{}]", "[" * 60 + "]" * 60, "") ,
    ],
)  # fmt: skip
def test_other_content_is_told(tmp_path, old, new, said):
    text = WHOLE.replace(old, new)
    if not said:  # of keys that no one asks for, nothing is said
        assert _read(tmp_path, text)
        return
    with pytest.raises(UserError, match=rf"card\.json is damaged \(.*({said}).*: delete it\.$") as error:
        _read(tmp_path, text)
    assert printable(str(error.value)) == str(error.value) and len(str(error.value)) < 400


def test_bytes_that_are_no_text_and_files_that_are_none_are_told(tmp_path):
    for content in (b"\xff\xfe\xfd", b"\x00\x01", b'{"a": "\xc3"}'):
        with pytest.raises(UserError, match=r"card\.json is damaged"):
            _read(tmp_path, content)
    os.mkfifo(tmp_path / "pipe.json")
    for path in (tmp_path, tmp_path / "pipe.json"):
        with pytest.raises(UserError, match="no regular file"):
            read_json(path, object, "delete it")
    with pytest.raises(UserError, match="does not exist"):
        read_json(tmp_path / "x", object, "delete it")
    with pytest.raises(UserError, match="cannot be opened"):
        read_json(tmp_path / ("x" * 300), object, "delete it")


@pytest.mark.parametrize(
    "text",
    [
        "a: &a [1, 1]\nb: [*a, *a]\n", "? [1, 2]\n: 3\n", "a: !!python/name:os.system\n",
        "- 1\n- 2\n", "a: [", "\tb: 1", "5", "a: " + "[" * 3000, "a: " + "[" * 99 + "]" * 99, "a: \x1b[31m",
    ],
)  # fmt: skip
def test_what_is_no_config_is_told(tmp_path, text):
    (tmp_path / "config.yaml").write_text(text)
    with pytest.raises(UserError, match=r"config\.yaml is damaged, no config \(.*\): choose another run_dir\.$"):
        read_config(tmp_path / "config.yaml", "choose another run_dir")


def test_configs_are_not_resolved(tmp_path, monkeypatch):
    monkeypatch.setenv("SECRET", "abc")
    (tmp_path / "config.yaml").write_text("a: ${oc.env:SECRET}\nb: {c: 1}\n")
    config = OmegaConf.to_container(read_config(tmp_path / "config.yaml", "x"))
    assert config == {"a": "${oc.env:SECRET}", "b": {"c": 1}}


def test_sentences_neither_steer_a_terminal_nor_fill_it():
    said = str(UserError("mug\x1b[2J\r\n\x07 \u202egpj.exe \ud800 é 手 \u2028"))
    assert said == r"mug\x1b[2J\r\n\x07 \u202egpj.exe \ud800 é 手 \u2028"
    assert said.encode() and 3000 < len(str(UserError("x" * 10**6))) < 4100
