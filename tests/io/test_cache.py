"""What is kept is believed only as it was written, under the name that it was written to."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest

from grabnet.io.cache import load_or_build


def _get(path: Path, built: list[str]) -> str:
    def build() -> str:
        built.append("built")
        return "value"

    return load_or_build(path, lambda content: content.decode("ascii"), build, str.encode)


def test_a_value_is_built_once(tmp_path):
    built: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert [_get(tmp_path / "a", built) for _ in range(2)] == ["value", "value"]
    assert built == ["built"]


def test_a_changed_byte_costs_a_warning_and_a_rebuild(tmp_path):
    path, built = tmp_path / "a", []
    _get(path, built)
    whole = path.read_bytes()
    damaged = [whole[:k] + bytes([whole[k] ^ 1]) + whole[k + 1 :] for k in range(0, len(whole), 7)]
    damaged += [whole[:k] for k in range(0, len(whole), 7)] + [whole + b"x", b"\n" * 10]
    for content in damaged:
        path.write_bytes(content)
        with pytest.warns(UserWarning, match="is damaged .*; it is built again"):
            assert _get(path, built) == "value"
        assert path.read_bytes() == whole
    assert len(built) == 1 + len(damaged)


def test_the_file_of_something_else_is_not_believed(tmp_path):
    built: list[str] = []
    _get(tmp_path / "a", built)
    (tmp_path / "a").rename(tmp_path / "b")
    with pytest.warns(UserWarning, match="not what was written"):
        _get(tmp_path / "b", built)
    (tmp_path / "b").unlink()
    (tmp_path / "b").mkdir()
    with pytest.warns(UserWarning, match="no file of a cache|cannot be written"):
        assert _get(tmp_path / "b", built) == "value"
