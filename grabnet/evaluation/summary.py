"""From each grasp's numbers to the tables': means over objects, with intervals, and whether their order makes sense."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from grabnet.evaluation.bootstrap import NOTHING, Estimate, mean, statistic
from grabnet.evaluation.cache import Arrays
from grabnet.evaluation.hands import Hands
from grabnet.evaluation.metrics import Metric
from grabnet.evaluation.protocols.diversity import Clusters, entropy

ALL = "all"
# Of these protocols true hands, wherever they are put, are the measure, not what should come out worse or better.
OF_HANDS_ALONE = ("posture", "diversity", "novelty")


@dataclass(eq=False)
class Row:
    """A method, its grasps of each object, and what was measured of them.

    Attributes:
        name: in the tables. about: a sentence.
        rank: rows of a lower one should come out better; None where nothing is expected.
        hands: by object.
        true_hands: whether the hands are recorded ones, if only moved.
        results: by object, then protocol: an array for each metric, whose first dimension is the grasps'.
        clusters: of the hands of all objects together.
    """

    name: str
    about: str
    rank: int | None
    hands: dict[str, Hands]
    true_hands: bool = False
    results: dict[str, dict[str, Arrays]] = field(default_factory=dict)
    clusters: Clusters | None = None

    def values(self, metric: Metric, thing: str) -> np.ndarray:
        """Those of an object's grasps that count, in the metric's unit; empty where nothing was measured."""
        found = self.results.get(thing, {}).get(metric.protocol, {}).get(metric.name)
        return np.empty(0) if found is None else found[: metric.samples].astype(float) * metric.scale


@dataclass(frozen=True, eq=False)
class Figure:
    """A number of the tables. object: `ALL` for the mean over objects, each weighing the same."""

    metric: Metric
    row: str
    object: str
    estimate: Estimate


def figures(
    rows: Sequence[Row], metrics: Sequence[Metric], objects: Sequence[str], draws: int, seed: int
) -> list[Figure]:
    """Every metric of every row, of each object and of all; those of which nothing was measured are left out.

    Args:
        draws: of the bootstrap.
    """
    found = []
    for metric in metrics:
        for row in rows:
            values = {thing: row.values(metric, thing) for thing in objects}
            estimates = {thing: mean([v], draws, seed) for thing, v in values.items()}
            if metric.protocol == "diversity":
                estimates = {ALL: _of_clusters(metric.name, row.clusters, draws, seed)}
            else:
                estimates[ALL] = mean(list(values.values()), draws, seed)
            found += [Figure(metric, row.name, thing, e) for thing, e in estimates.items() if np.isfinite(e.value)]
    return found


def _of_clusters(name: str, clusters: Clusters | None, draws: int, seed: int) -> Estimate:
    """Redrawn hands stay in the clusters of all."""
    if clusters is None:
        return NOTHING
    if name == "cluster_size":
        return mean([clusters.distance], draws, seed)
    return statistic(len(clusters.label), lambda index: entropy(np.bincount(clusters.label[index])), draws, seed)


def find(found: Sequence[Figure], metric: Metric, row: str, thing: str = ALL) -> Estimate | None:
    """The number in a table's cell, if there is one."""
    same = (f.estimate for f in found if f.metric == metric and f.row == row and f.object == thing)
    return next(same, None)


def surprises(found: Sequence[Figure], rows: Sequence[Row], metrics: Sequence[Metric]) -> list[str]:
    """A sentence for every two rows that come out in the other order than they should, by more than chance: in which
    metrics, and how."""
    sentences = []
    for one, other in combinations(rows, 2):
        if None in (one.rank, other.rank) or one.rank == other.rank:
            continue
        good, bad = (one, other) if one.rank < other.rank else (other, one)
        where = []
        for metric in metrics:
            if metric.better is None or (metric.protocol in OF_HANDS_ALONE and (good.true_hands or bad.true_hands)):
                continue
            a, b = find(found, metric, good.name), find(found, metric, bad.name)
            if a and b and (a.above(b) if metric.better == "lower" else b.above(a)):
                where.append(
                    f"{metric.title} ({b.value:.3g} against {a.value:.3g}{f' {metric.unit}' if metric.unit else ''})"
                )
        if where:
            sentences.append(
                f"{bad.name} comes out better than {good.name}, by more than chance, in {', '.join(where)}."
            )
    return sentences
