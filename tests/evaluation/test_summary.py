"""Means, intervals and the order of rows."""

import numpy as np
import pytest

from grabnet.evaluation.bootstrap import NOTHING, mean, statistic
from grabnet.evaluation.metrics import Metric
from grabnet.evaluation.reporting.tables import digits
from grabnet.evaluation.summary import ALL, Row, figures, find, surprises

DEPTH = Metric("penetration", "max", "mm", "depth", "lower")
SHARE = Metric("halo", "contact", "%", "share", "higher", 2)
BENT = Metric("posture", "excess", "°", "angle", "lower")


def row(name: str, rank: int | None, true_hands: bool = False, **values: list[float]) -> Row:
    """values: of two objects, alike."""
    results = {"penetration": {"max": "depth"}, "halo": {"contact": "share"}, "posture": {"excess": "bent"}}
    found = {
        protocol: {name: np.array(values[key]) for name, key in names.items() if key in values}
        for protocol, names in results.items()
    }
    return Row(name, "", rank, {}, true_hands, {"a": found, "b": found})


def test_the_interval_of_a_mean_is_that_of_the_normal_distribution():
    values = np.random.default_rng(0).normal(3, 2, 4000)
    estimate = mean([values], 4000, 0)
    assert estimate.value == pytest.approx(values.mean())
    error = values.std() / np.sqrt(len(values))
    np.testing.assert_allclose(estimate.interval, values.mean() + 1.96 * error * np.array([-1, 1]), atol=0.15 * error)


def test_objects_weigh_the_same_however_many_grasps_they_have():
    estimate = mean([np.full(3, 1.0), np.full(300, 5.0)], 10, 0)
    assert estimate.value == 3
    assert estimate.interval == (3, 3)
    assert estimate.n == 303


def test_what_could_not_be_measured_does_not_count():
    estimate = mean([np.array([1, np.nan, 3]), np.full(2, np.nan)], 10, 0)
    assert estimate.value == 2
    assert estimate.n == 2
    assert mean([np.full(2, np.nan)], 10, 0) is NOTHING
    assert all(np.isnan(NOTHING.interval))


def test_a_biased_statistic_is_moved_back():
    """The number of different grasps among those redrawn is always lower than that of all."""
    estimate = statistic(50, lambda index: float(len(np.unique(index))), 500, 0)
    assert estimate.value == 50
    assert estimate.drawn.mean() == pytest.approx(50)


def test_figures_of_each_object_and_all():
    rows = [row("one", 0, depth=[1, 2, 3], share=[1, 0, 0])]
    found = figures(rows, [DEPTH, SHARE, BENT], ["a", "b"], 20, 0)
    assert find(found, DEPTH, "one", "a").value == 2
    assert find(found, DEPTH, "one").n == 6
    assert find(found, SHARE, "one", ALL).value == 50  # the first two, in percent
    assert find(found, BENT, "one") is None
    assert {f.object for f in found} == {"a", "b", ALL}


def test_rows_in_the_wrong_order_are_told():
    true = row("true", 0, True, depth=[5, 5.1] * 20, share=[1, 1], bent=[9.0] * 40)
    good = row("good", 1, depth=[1, 1.1] * 20, share=[0, 0], bent=[0.0] * 40)
    other = row("other", None, depth=[0.0] * 40, share=[0, 0], bent=[0.0] * 40)
    found = figures([true, good, other], [DEPTH, SHARE, BENT], ["a", "b"], 100, 0)
    told = surprises(found, [true, good, other], [DEPTH, SHARE, BENT])
    assert told == ["good comes out better than true, by more than chance, in penetration/max (1.05 against 5.05 mm)."]


def test_differences_within_chance_are_not_told():
    rng = np.random.default_rng(0)
    rows = [row(name, k, depth=list(rng.normal(size=40))) for k, name in enumerate(("one", "two"))]
    assert surprises(figures(rows, [DEPTH], ["a", "b"], 500, 0), rows, [DEPTH]) == []


def test_three_digits():
    shown = {0.0: "0", 0.00012: "0", 0.0123: "0.012", 0.0996: "0.10", 1.2345: "1.23", 9.999: "10.0", 99.96: "100"}
    assert {value: digits(value) for value in shown} == shown
    assert digits(float("nan")) == "–"
