import os
import signal

import numpy as np
import pytest

from grabnet.errors import UserError
from grabnet.evaluation.cache import Cache, ResultTable
from grabnet.evaluation.hands import Hands
from grabnet.evaluation.measuring import Task, measured
from grabnet.evaluation.protocol import PerGrasp
from tests.evaluation.shapes import ball, moved
from tests.faults import files_of_at_most


@pytest.fixture
def cache(tmp_path) -> Cache:
    return Cache(tmp_path / "cache")


def test_computed_once_for_equal_content(cache):
    calls = []

    def compute() -> dict[str, np.ndarray]:
        calls.append(1)
        return {"x": np.arange(3), "scalar": np.array(2.5), "turned": np.arange(6.0).reshape(2, 3).T}

    first = cache.get("kind", ["a", np.ones(2)], compute)
    second = cache.get("kind", ["a", np.ones(2)], compute)
    assert len(calls) == 1
    for name, array in first.items():
        np.testing.assert_array_equal(second[name], array)
        assert second[name].shape == array.shape
    cache.get("kind", ["a", np.zeros(2)], compute)
    cache.get("other", ["a", np.ones(2)], compute)
    assert len(calls) == 3
    assert cache.path("kind", ["ab", "c"]) != cache.path("kind", ["a", "bc"])


def test_a_damaged_file_costs_a_warning(cache):
    cache.get("kind", ["a"], lambda: {"x": np.ones(1)})
    cache.path("kind", ["a"]).write_bytes(b"nothing of the sort")
    with pytest.warns(UserWarning, match="damaged"):
        found = cache.get("kind", ["a"], lambda: {"x": np.zeros(1)})
    assert found["x"] == 0


def test_a_full_disk_costs_a_warning(cache, tmp_path):
    table = ResultTable(tmp_path / "t.safetensors")
    table.add(["a"], {"x": np.zeros((1, 1000))})
    with files_of_at_most(4096), pytest.warns(UserWarning, match="cannot be written"):
        table.save()
    with files_of_at_most(4096), pytest.warns(UserWarning, match="cannot be written"):
        assert len(cache.get("kind", ["a"], lambda: {"x": np.zeros(1000)})["x"]) == 1000


def test_a_table_keeps_rows_by_name(tmp_path):
    table = ResultTable(tmp_path / "t.safetensors")
    table.add(["b", "a"], {"x": np.array([1.0, 2.0]), "m": np.arange(6, dtype=np.uint8).reshape(2, 3)})
    table.save()
    table = ResultTable(tmp_path / "t.safetensors")
    assert "a" in table
    assert "c" not in table
    table.add(["c"], {"x": np.array([3.0]), "m": np.array([[7, 8, 9]], np.uint8)})
    found = table.rows(["c", "a", "a"])
    np.testing.assert_array_equal(found["x"], [3, 2, 2])
    np.testing.assert_array_equal(found["m"], [[7, 8, 9], [3, 4, 5], [3, 4, 5]])


def test_json_is_kept_as_it_is(cache):
    value = {"text": "ε ≤ 4.5 mm", "numbers": [1, 2.5, None]}
    assert cache.get_json("kind", ["a"], lambda: value) == value
    assert cache.get_json("kind", ["a"], lambda: pytest.fail("was computed again")) == value
    cache.path("kind", ["a"]).with_suffix(".json").write_text("{", encoding="utf-8")
    with pytest.warns(UserWarning, match="damaged"):
        assert cache.get_json("kind", ["a"], lambda: []) == []


def test_a_table_keeps_texts(tmp_path):
    table = ResultTable(tmp_path / "t.safetensors")
    table.add(["a", "b"], {"x": np.array([1.0, 2.0]), "why": np.array(["", "zu groß"])})
    table.save()
    table = ResultTable(tmp_path / "t.safetensors")
    table.add(["c"], {"x": np.array([3.0]), "why": np.array(["a much longer reason"])})
    table.save()
    results = ResultTable(tmp_path / "t.safetensors").rows(["c", "b", "a"])
    assert results["why"].tolist() == ["a much longer reason", "zu groß", ""]
    np.testing.assert_array_equal(results["x"], [3, 2, 1])


class Counting(PerGrasp):
    """Measures the x of a hand's first vertex, and counts how often."""

    name = "counting"

    def __init__(self, only_first: int | None = None, fails: bool = False):
        """fails: when called a second time."""
        self.only_first = only_first
        self.fails = fails
        self.hands = 0

    def __call__(self, scene) -> dict[str, np.ndarray]:
        if self.fails and self.hands:
            raise RuntimeError("no more")
        self.hands += len(scene.hands)
        return {"x": scene.hands.vertices[:, 0, 0].astype(float)}


def test_each_grasp_is_measured_once(cache):
    """Though two tasks share some, and more come later."""
    solid, hands = ball(1, 1), moved(ball(1, 1), *[(k, 0, 0) for k in range(60)])
    counting = Counting()
    tasks = [Task(start, solid, hands.select(slice(start, end)), [counting]) for start, end in ((0, 40), (20, 50))]
    results = measured(tasks, cache, 1)
    assert counting.hands == 50
    np.testing.assert_array_equal(results[20]["counting/x"], hands.vertices[20:50, 0, 0])
    again = measured([Task("all", solid, hands, [counting])], cache, 1)
    assert counting.hands == 60
    np.testing.assert_array_equal(again["all"]["counting/x"], hands.vertices[:, 0, 0])
    measured([Task("other", ball(2, 1), hands.select(slice(0, 5)), [counting])], cache, 1)
    assert counting.hands == 65


class Nearest(PerGrasp):
    """Measures the distance of a hand's first vertex to that of the nearest recorded hand."""

    name = "nearest"
    needs_truth = True

    def __call__(self, scene) -> dict[str, np.ndarray]:
        offset = scene.hands.vertices[:, None, 0] - scene.truth.vertices[None, :, 0]
        return {"distance": np.linalg.norm(offset, axis=-1).min(1).astype(float)}


def test_a_task_inserted_in_the_middle_shifts_nothing(cache):
    solid, hands = ball(1, 1), moved(ball(1, 1), *[(k, 0, 0) for k in range(9)])
    first, middle, last = (
        Task(name, solid, hands.select(slice(start, start + 3)), [Counting(only_first)], hands)
        for name, start, only_first in (("first", 0, None), ("middle", 3, 2), ("last", 6, None))
    )
    without = measured([first, last], cache, 1)
    results = measured([first, middle, last], Cache(cache.folder / "fresh"), 1)
    assert set(results) == {"first", "middle", "last"}
    for name, expected in without.items():
        np.testing.assert_array_equal(results[name]["counting/x"], expected["counting/x"])
    np.testing.assert_array_equal(results["middle"]["counting/x"], hands.vertices[3:5, 0, 0])
    with pytest.raises(ValueError, match="different keys"):
        measured([first, middle, first], cache, 1)
    with pytest.raises(ValueError, match="two protocols measure counting/x"):
        measured([Task("twice", solid, hands, [Counting(), Counting()])], cache, 1)


def test_what_is_compared_with_recorded_grasps_is_kept_by_these(cache):
    solid, hands = ball(1, 1), moved(ball(1, 1), (0, 0, 0), (5, 0, 0))
    for offset in (1, 2, 1):
        truth = moved(ball(1, 1), (offset, 0, 0))
        results = measured([Task("a", solid, hands, [Nearest(), Counting()], truth)], cache, 1)
        np.testing.assert_allclose(results["a"]["nearest/distance"], [offset, 5 - offset])


def test_what_was_measured_is_kept_when_the_rest_fails(cache):
    solid, hands = ball(1, 1), moved(ball(1, 1), *[(k, 0, 0) for k in range(40)])
    with pytest.raises(RuntimeError, match="no more"):
        measured([Task(0, solid, hands, [Counting(fails=True)])], cache, 1)
    counting = Counting()
    measured([Task(0, solid, hands, [counting])], cache, 1)
    assert counting.hands == 15


class Dying(PerGrasp):
    """Kills the process that measures the second portion."""

    name = "dying"

    def __call__(self, scene) -> dict[str, np.ndarray]:
        if scene.hands.vertices[0, 0, 0] > 20:
            os.kill(os.getpid(), signal.SIGKILL)
        return {"x": scene.hands.vertices[:, 0, 0].astype(float)}


def test_a_killed_process_is_told_in_a_sentence(cache):
    solid, hands = ball(1, 1), moved(ball(1, 1), *[(k, 0, 0) for k in range(40)])
    with pytest.raises(UserError, match=r"was killed, perhaps for want of memory\. .* fewer processes than 2"):
        measured([Task(0, solid, hands, [Dying()])], cache, 2)


def test_arrays_come_in_the_order_of_their_names(cache):
    arrays = {name: np.ones(1) for name in "hgfedcba"}
    for _ in range(2):
        found = cache.get("kind", ["a"], lambda: arrays)
    assert list(found) == sorted(arrays)


def test_keys_tell_hands_apart():
    hands = moved(ball(1, 1), (0, 0, 0), (1, 0, 0), (0, 0, 0))
    assert hands.keys[0] == hands.keys[2] != hands.keys[1]
    recorded = Hands(vertices=hands.vertices, faces=hands.faces, sequences=np.arange(3))
    assert len({*hands.keys, *recorded.keys}) == 5
