"""Means, intervals and the order of rows."""

import numpy as np
import pytest
import scipy.stats

from grabnet.cli.numbers import digits
from grabnet.evaluation.bootstrap import NOTHING, mean, statistic
from grabnet.evaluation.methods import Method
from grabnet.evaluation.metrics import ALL, Metric
from grabnet.evaluation.summary import expected_order, failures, figures, find, unexpected_order

DEPTH = Metric("penetration", "max", "mm", "depth", "lower")
SHARE = Metric("halo", "contact", "%", "share", "higher", 2)
BENT = Metric("posture", "excess", "°", "angle", "lower", of_hand_alone=True)


def row(name: str, rank: int | None, is_recorded: bool = False, **values: list[float]) -> Method:
    """values: of two objects, alike."""
    titles = {"depth": DEPTH.title, "share": SHARE.title, "bent": BENT.title}
    results = {titles[key]: np.array(numbers) for key, numbers in values.items()}
    return Method(name, "", rank, {}, is_recorded, {"a": results, "b": results})


def test_the_interval_of_a_mean_is_that_of_the_normal_distribution():
    values = np.random.default_rng(0).normal(3, 2, 4000)
    estimate = mean([values], 4000, 0)
    assert estimate.value == pytest.approx(values.mean())
    error = values.std() / np.sqrt(len(values))
    np.testing.assert_allclose(estimate.interval, values.mean() + 1.96 * error * np.array([-1, 1]), atol=0.15 * error)


def test_the_redrawings_are_those_of_scipy():
    rng = np.random.default_rng(3)
    groups = [rng.normal(size=20), rng.normal(size=30)]
    estimate = mean(groups, 200, 7)
    reference = scipy.stats.bootstrap(
        groups,
        lambda *samples, axis=-1: np.mean([sample.mean(axis) for sample in samples], axis=0),
        n_resamples=200,
        vectorized=True,
        method="percentile",
        random_state=np.random.default_rng(7),
    )
    np.testing.assert_allclose(estimate.drawn, reference.bootstrap_distribution, rtol=1e-12)
    np.testing.assert_allclose(estimate.interval, reference.confidence_interval, rtol=1e-9)


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


def test_rows_in_the_wrong_order_are_named():
    true = row("true", 0, True, depth=[5, 5.1] * 20, share=[1, 1], bent=[9.0] * 40)
    good = row("good", 1, depth=[1, 1.1] * 20, share=[0, 0], bent=[0.0] * 40)
    other = row("other", None, depth=[0.0] * 40, share=[0, 0], bent=[0.0] * 40)
    found = figures([true, good, other], [DEPTH, SHARE, BENT], ["a", "b"], 100, 0)
    sentences = unexpected_order(found, [true, good, other], [DEPTH, SHARE, BENT])
    assert sentences == [
        "good comes out better than true, by more than chance, in penetration/max (1.05 against 5.05 mm)."
    ]


def test_differences_within_chance_are_not_named():
    rng = np.random.default_rng(0)
    rows = [row(name, k, depth=list(rng.normal(size=40))) for k, name in enumerate(("one", "two"))]
    assert unexpected_order(figures(rows, [DEPTH], ["a", "b"], 500, 0), rows, [DEPTH]) == []


def test_the_expected_order_is_that_of_ranks():
    rows = [row("c", 3), row("a", 0), row("other", None), row("b", 1), row("b2", 1)]
    assert expected_order(rows) == "a, then b and b2, then c"


def test_failures_are_counted_by_object_and_reason():
    one, other = row("one", None), row("other", None)
    one.results = {"a": {"p/failure": np.array(["", "stuck"]), "q/failure": np.array(["", "stuck"])}, "b": {}}
    other.results = {"a": {"p/failure": np.array(["stuck", "lost"])}}
    assert failures([one, other], ["p", "q"], ["a", "b"]) == [
        "a: p failed for 2 of 4 grasps: stuck",
        "a: p failed for 1 of 4 grasps: lost",
        "a: q failed for 1 of 2 grasps: stuck",
    ]
    one.results["a"]["q/failure"] = other.results["a"]["q/failure"] = np.array(["stuck", ""])
    sentences = failures([one, other], ["p", "q", "p"], ["a"])
    assert sentences[0] == "a: p and q failed for 2 of 4 grasps: stuck"


def test_three_digits():
    shown = {0.0: "0", 0.00012: "0", 0.0123: "0.012", 0.0996: "0.10", 1.2345: "1.23", 9.999: "10.0", 99.96: "100"}
    assert {value: digits(value) for value in shown} == shown
    assert digits(float("nan")) == "–"
