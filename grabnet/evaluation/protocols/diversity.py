"""Protocols `diversity`, `novelty` and `coverage`: how varied grasps are, how new, how many true ones they reach."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist

from grabnet.evaluation.metrics import Metric

N_CLUSTERS = 20

METRICS = (
    Metric("diversity", "entropy", "nats", f"of the {N_CLUSTERS} clusters' shares; at most 3.00", "higher"),
    Metric(
        "diversity", "cluster_size", "cm", "mean distance of the 63-D keypoints to their cluster's centre", "higher"
    ),
    Metric("novelty", "distance", "cm", "mean distance of the 21 keypoints to those of the nearest training grasp"),
    Metric("coverage", "reached", "%", "held-out true grasps that are the nearest one of some grasp", "higher"),
)


class Clusters(NamedTuple):
    """label (N,) of each hand's cluster, and distance (N,) to its centre, cm."""

    label: np.ndarray
    distance: np.ndarray

    @property
    def entropy(self) -> float:
        """Of the shares of the clusters, nats."""
        return entropy(np.bincount(self.label))

    def drawn(self, index: np.ndarray) -> Clusters:
        """The chosen hands, in the clusters of all."""
        return Clusters(self.label[index], self.distance[index])


def cluster(keypoints: np.ndarray, seed: int, k: int = N_CLUSTERS) -> Clusters | None:
    """k-means of hands, all objects together (ref. 9, `diversity`).

    Args:
        keypoints: (N, 21, 3) metres in each hand's own frame, as `HandLabels.keypoints` gives them; in cm they are the
            63 dimensions.
        seed: of k-means.

    Returns:
        None where there are fewer hands than clusters.
    """
    from sklearn.cluster import KMeans  # here: an extra, which only evaluation needs

    points = 100 * keypoints.reshape(len(keypoints), -1)
    if len(points) < k:
        return None
    found = KMeans(k, n_init=10, random_state=seed).fit(points)
    return Clusters(found.labels_, np.linalg.norm(points - found.cluster_centers_[found.labels_], axis=1))


def entropy(counts: np.ndarray) -> float:
    """Of shares that are proportional to counts, nats."""
    share = counts[counts > 0] / counts.sum()
    return float(-(share * np.log(share)).sum())


def novelty(keypoints: np.ndarray, training: np.ndarray) -> np.ndarray:
    """(N,) cm: mean distance between the 21 keypoints (N, 21, 3) of each hand and those of the nearest of the training
    hands (M, 21, 3), all in their own frames: how new a posture is, wherever the hand is."""
    total = np.zeros((len(keypoints), len(training)))
    for k in range(keypoints.shape[1]):
        total += cdist(keypoints[:, k], training[:, k])
    return 100 * total.min(1) / keypoints.shape[1]


def reached(nearest: np.ndarray, n_reference: int) -> np.ndarray:
    """(n_reference,) 1 for each held-out true grasp of an object that is the nearest one (`ClosestHand`) of some of the
    grasps; `nearest` (N,) holds their numbers."""
    return np.isin(np.arange(n_reference), nearest).astype(float)
