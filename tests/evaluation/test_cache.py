import numpy as np
import pytest

from grabnet.evaluation.cache import Cache, Table
from grabnet.evaluation.hands import Hands
from grabnet.evaluation.measuring import Task, measured
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
    table = Table(tmp_path / "t.safetensors")
    table.add(["a"], {"x": np.zeros((1, 1000))})
    with files_of_at_most(4096), pytest.warns(UserWarning, match="cannot be written"):
        table.save()
    with files_of_at_most(4096), pytest.warns(UserWarning, match="cannot be written"):
        assert len(cache.get("kind", ["a"], lambda: {"x": np.zeros(1000)})["x"]) == 1000


def test_a_table_keeps_rows_by_name(tmp_path):
    table = Table(tmp_path / "t.safetensors")
    table.add(["b", "a"], {"x": np.array([1.0, 2.0]), "m": np.arange(6, dtype=np.uint8).reshape(2, 3)})
    table.save()
    table = Table(tmp_path / "t.safetensors")
    assert "a" in table
    assert "c" not in table
    table.add(["c"], {"x": np.array([3.0]), "m": np.array([[7, 8, 9]], np.uint8)})
    found = table.rows(["c", "a", "a"])
    np.testing.assert_array_equal(found["x"], [3, 2, 2])
    np.testing.assert_array_equal(found["m"], [[7, 8, 9], [3, 4, 5], [3, 4, 5]])


class Counting:
    """Measures the x of a hand's first vertex, and counts how often."""

    name, settings, metrics = "counting", "", ()

    def __init__(self):
        self.hands = 0

    def __call__(self, scene) -> dict[str, np.ndarray]:
        self.hands += len(scene.hands)
        return {"x": scene.hands.vertices[:, 0, 0].astype(float)}


def test_each_grasp_is_measured_once(cache):
    """Though two tasks share some, and more come later."""
    solid, hands = ball(1, 1), moved(ball(1, 1), *[(k, 0, 0) for k in range(60)])
    counting = Counting()
    results = measured(
        [Task(solid, hands.select(slice(0, 40)), [counting]), Task(solid, hands.select(slice(20, 50)), [counting])],
        cache,
        1,
    )
    assert counting.hands == 50
    np.testing.assert_array_equal(results[1]["counting"]["x"], hands.vertices[20:50, 0, 0])
    again = measured([Task(solid, hands, [counting])], cache, 1)
    assert counting.hands == 60
    np.testing.assert_array_equal(again[0]["counting"]["x"], hands.vertices[:, 0, 0])
    measured([Task(ball(2, 1), hands.select(slice(0, 5)), [counting])], cache, 1)
    assert counting.hands == 65


def test_what_was_measured_is_kept_when_the_rest_fails(cache):
    solid, hands = ball(1, 1), moved(ball(1, 1), *[(k, 0, 0) for k in range(40)])

    class Failing(Counting):
        def __call__(self, scene) -> dict[str, np.ndarray]:
            if self.hands:
                raise RuntimeError("no more")
            return super().__call__(scene)

    with pytest.raises(RuntimeError, match="no more"):
        measured([Task(solid, hands, [Failing()])], cache, 1)
    counting = Counting()
    measured([Task(solid, hands, [counting])], cache, 1)
    assert counting.hands == 15


def test_keys_tell_hands_apart():
    hands = moved(ball(1, 1), (0, 0, 0), (1, 0, 0), (0, 0, 0))
    assert hands.keys[0] == hands.keys[2] != hands.keys[1]
    recorded = Hands(vertices=hands.vertices, faces=hands.faces, sequences=np.arange(3))
    assert len({*hands.keys, *recorded.keys}) == 5
