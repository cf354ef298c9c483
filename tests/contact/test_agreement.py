"""How far annotations agree, against counts made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from grabnet.contact.agreement import agreeing, shares


def test_parts_and_vertices_that_both_have():
    one = np.array([[1, 1, 2, 0], [3, 0, 0, 0], [0, 0, 0, 0], [0, 0, 5, 5]], np.uint8)
    other = np.array([[1, 2, 0, 4], [3, 3, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]], np.uint8)
    counts = agreeing(one, other)
    # Frame 0: parts 1, 2 of 1, 2, 4; frame 1: 3; frame 2: none; frame 3: 5 in one only.
    assert counts["frames"] == 3 and counts["frame_overlap"] == pytest.approx(2 / 3 + 1)
    assert [counts[f"parts_{who}"] for who in ("one", "other", "both")] == [4, 4, 3]
    assert [counts[f"vertices_{who}"] for who in ("one", "other", "both")] == [6, 5, 3]
    found = shares(counts)
    assert found == {"part_agreement": pytest.approx(5 / 9), "part_f1": 6 / 8, "vertex_f1": 6 / 11}
    assert shares(counts + agreeing(one, one))["part_f1"] == pytest.approx(2 * (3 + 4) / (8 + 8)), "counts add up"


def test_nothing_agrees_with_nothing():
    nothing = np.zeros((3, 4), np.uint8)
    assert set(shares(agreeing(nothing, nothing)).values()) == {1.0}
