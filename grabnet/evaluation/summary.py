"""From each grasp's numbers to the tables': means over objects, with intervals, and whether their order makes sense."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, groupby

import numpy as np

from grabnet.evaluation.bootstrap import Estimate, mean
from grabnet.evaluation.methods import Method
from grabnet.evaluation.metrics import ALL, Metric


@dataclass(frozen=True, eq=False)
class Figure:
    """A number of the tables.

    Attributes:
        metric: what it is.
        method: name of the method.
        object: `ALL` for the mean over objects, each weighing the same.
        estimate: value and interval.
    """

    metric: Metric
    method: str
    object: str
    estimate: Estimate


def figures(
    methods: Sequence[Method], metrics: Sequence[Metric], objects: Sequence[str], draws: int, seed: int
) -> list[Figure]:
    """Return every metric of every method, of each object and of all; without those of which nothing was measured.

    Args:
        methods: measured.
        metrics: in the order of the tables.
        objects: names.
        draws: of the bootstrap.
        seed: of the bootstrap.
    """
    numbers = []
    for metric in metrics:
        for method in methods:
            if metric.title in method.estimates:
                estimates = {ALL: method.estimates[metric.title]}
            else:
                values = {name: method.values(metric, name) for name in objects}
                estimates = {name: mean([v], draws, seed) for name, v in values.items()}
                estimates[ALL] = mean(list(values.values()), draws, seed)
            numbers += [Figure(metric, method.name, name, e) for name, e in estimates.items() if np.isfinite(e.value)]
    return numbers


def find(numbers: Sequence[Figure], metric: Metric, method: str, object_name: str = ALL) -> Estimate | None:
    """Return the number of a table's cell, if there is one."""
    same = (f.estimate for f in numbers if f.object == object_name and f.method == method and f.metric == metric)
    return next(same, None)


def expected_order(methods: Sequence[Method]) -> str:
    """Return the methods' names, best first, as their ranks have it: "A, then B and C, then D"."""
    ranked = sorted((method for method in methods if method.rank is not None), key=lambda method: method.rank)
    groups = groupby(ranked, key=lambda method: method.rank)
    return ", then ".join(" and ".join(method.name for method in group) for _, group in groups)


def unexpected_order(numbers: Sequence[Figure], methods: Sequence[Method], metrics: Sequence[Metric]) -> list[str]:
    """Return a sentence for every two methods that come out in the other order than expected, by more than chance: in
    which metrics, and how."""
    sentences = []
    for one, other in combinations(methods, 2):
        if None in (one.rank, other.rank) or one.rank == other.rank:
            continue
        good, bad = (one, other) if one.rank < other.rank else (other, one)
        where = []
        for metric in metrics:
            if metric.better is None or (metric.of_hand_alone and (good.is_recorded or bad.is_recorded)):
                continue
            a, b = find(numbers, metric, good.name), find(numbers, metric, bad.name)
            if a and b and (a.above(b) if metric.better == "lower" else b.above(a)):
                unit = f" {metric.unit}" if metric.unit else ""
                where.append(f"{metric.title} ({b.value:.3g} against {a.value:.3g}{unit})")
        if where:
            sentences.append(
                f"{bad.name} comes out better than {good.name}, by more than chance, in {', '.join(where)}."
            )
    return sentences


def failures(methods: Sequence[Method], protocols: Sequence[str], objects: Sequence[str]) -> list[str]:
    """Return a sentence for every object and reason for which grasps could not be measured.

    Args:
        methods: measured.
        protocols: names of those that may have results `failure`.
        objects: names.
    """
    failed: dict[tuple[str, str, int, int], list[str]] = {}
    for object_name in objects:
        for protocol in dict.fromkeys(protocols):
            results = [method.results.get(object_name, {}).get(f"{protocol}/failure", ()) for method in methods]
            reasons = [str(reason) for of_method in results for reason in of_method]
            for reason, count in Counter(filter(None, reasons)).most_common():
                failed.setdefault((object_name, reason, count, len(reasons)), []).append(protocol)
    return [
        f"{object_name}: {' and '.join(names)} failed for {count} of {total} grasps: {reason}"
        for (object_name, reason, count, total), names in failed.items()
    ]
