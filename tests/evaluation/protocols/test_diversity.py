from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from grabnet.evaluation.protocols.diversity import Diversity, WhitenedDiversity, cluster, novelty, reached


def bunches(sizes: list[int], spread: float, seed: int = 0) -> np.ndarray:
    """(sum of sizes, 21, 3) keypoints in bunches far from each other, each point `spread` metres from its centre."""
    rng = np.random.default_rng(seed)
    centres = rng.normal(0, 1, (len(sizes), 63))
    offset = rng.normal(size=(sum(sizes), 63))
    offset *= spread / np.linalg.norm(offset, axis=1, keepdims=True)
    points = np.repeat(centres, sizes, axis=0) + offset
    return points.reshape(-1, 21, 3)


def diversity(*points: np.ndarray | None) -> dict:
    """Of hands of several objects, given by their keypoints."""
    labels = SimpleNamespace(keypoints=lambda hands: hands)
    return Diversity(labels, draws=50, seed=0)(SimpleNamespace(hands=dict(enumerate(points))))


def test_clusters_of_known_entropy():
    sizes = [10] * 10 + [30] * 10
    points = bunches(sizes, 0.001)
    found = diversity(points[:150], points[150:])
    share = np.array(sizes) / sum(sizes)
    assert found["entropy"].value == pytest.approx(-(share * np.log(share)).sum())
    assert found["entropy"].interval[0] < found["entropy"].value < found["entropy"].interval[1]
    # Of points at one distance from where they were thrown around, the mean is near that, and so is theirs to it.
    assert found["cluster_size"].value == pytest.approx(0.1, rel=0.1)
    assert sorted(np.bincount(cluster(points.reshape(-1, 63), seed=0).label)) == sizes


def test_whitened_clusters_do_not_depend_on_units_or_on_coordinates_that_never_change():
    points = bunches([10] * 10 + [30] * 10, 0.001)
    points[:, 0] = 0.5  # as the wrist is
    labels = SimpleNamespace(keypoints=lambda hands: hands)

    def of(keypoints: np.ndarray) -> dict:
        return WhitenedDiversity(labels, draws=50, seed=0)(SimpleNamespace(hands={"a": keypoints}))

    stretch = np.linspace(0.5, 20, 63).reshape(21, 3)
    one, other = of(points), of(points * stretch)
    for name in ("entropy", "cluster_size"):
        assert one[name].value == pytest.approx(other[name].value)
    flat = points.reshape(len(points), -1)[:, 3:]
    assert one["entropy"].value == diversity(points)["entropy"].value  # bunches this far apart stay the same
    scattered = np.linalg.norm((flat - np.repeat(_means(flat), [10] * 10 + [30] * 10, axis=0)) / flat.std(0), axis=1)
    assert one["cluster_size"].value == pytest.approx(scattered.mean())
    assert of(points[:19]) == {}


def _means(flat: np.ndarray) -> np.ndarray:
    edges = np.cumsum([0] + [10] * 10 + [30] * 10)
    return np.stack([flat[a:b].mean(0) for a, b in pairwise(edges)])


def test_even_clusters_have_the_most_entropy_and_few_hands_none():
    assert diversity(bunches([6] * 20, 0.001))["entropy"].value == pytest.approx(np.log(20))
    assert diversity(bunches([1] * 19, 0.0)) == {}
    assert diversity(bunches([6] * 20, 0.001), None) == {}


def test_the_same_seed_gives_the_same_clusters():
    points = np.random.default_rng(0).normal(size=(200, 63))
    one, other = cluster(points, seed=3), cluster(points, seed=3)
    np.testing.assert_array_equal(one.label, other.label)
    np.testing.assert_array_equal(one.distance, other.distance)


def test_novelty_by_brute_force():
    rng = np.random.default_rng(0)
    made, training = rng.normal(size=(4, 21, 3)), rng.normal(size=(9, 21, 3))
    expected = [100 * min(np.linalg.norm(m - t, axis=1).mean() for t in training) for m in made]
    np.testing.assert_allclose(novelty(made, training), expected)
    np.testing.assert_allclose(novelty(training[2:4], training), 0)


def test_what_is_reached():
    np.testing.assert_array_equal(reached(np.array([0, 3, 3, 3]), 5), [1, 0, 0, 1, 0])
