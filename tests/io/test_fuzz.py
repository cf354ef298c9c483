"""The short run of `tests.fuzz`: mutated files of every format end in a value or in a sentence."""

from __future__ import annotations

import pytest

from tests.fuzz import Target, failure_of, mutations, targets

NAMES = [
    "sequence", *(f"pickle {protocol}" for protocol in range(6)), "hand model", "pickled hand model", "array",
    "subjects of the release", "frame names", "rows", "basis", "CoarseNet", "RefineNet", "checkpoint", "store", "shard",
    "subjects", "recipe", "comparison", "history", "outcome", "metrics", "provenance", "config", "report", "grasps",
    "record of grasps", "shipped grasps", "archive",
]  # fmt: skip
# Of those that take longer to read.
_SLOW = {"CoarseNet", "RefineNet", "archive", "hand model", "pickled hand model", "grasps"}


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> dict[str, Target]:
    return targets(tmp_path_factory.mktemp("fuzz"))


@pytest.mark.parametrize("name", NAMES)
def test_mutated_files_end_in_a_value_or_a_sentence(made, name):
    assert set(made) == set(NAMES)
    target = made[name]
    whole = target.file.read_bytes()
    try:
        assert failure_of(target, whole) is None
        for content in mutations(target, 12 if name in _SLOW else 40, seed=0):
            assert (failure := failure_of(target, content)) is None, failure
    finally:
        target.file.write_bytes(whole)
