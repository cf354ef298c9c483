"""Protocols `diversity`, `novelty`, `coverage`, and the clusters of `volco`: how varied grasps are, how new, how many
true ones they reach."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from scipy.spatial.distance import cdist
from scipy.stats import entropy

from grabnet.evaluation.bootstrap import Estimate, mean, statistic
from grabnet.evaluation.hands import HandLabels
from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.methods import Method
from grabnet.evaluation.metrics import FIELD, HAND, VOLCO, Metric
from grabnet.evaluation.protocol import MeasuredGrasps, PerMethod, PerObject
from grabnet.evaluation.recorded import held_out

N_CLUSTERS = 20


class Diversity(PerMethod):
    """Clusters of the hands of all objects: entropy of their shares, nats, and mean distance to their centres, cm.

    Redrawn hands stay in the clusters of all. Missing for hands of other vertices than the model's, and for fewer hands
    than clusters.

    Args:
        labels: of the hand model.
        draws: of the bootstrap.
        seed: of k-means and bootstrap.
    """

    name = "diversity"

    def __init__(self, labels: HandLabels, draws: int, seed: int):
        self.labels = labels
        self.draws = draws
        self.seed = seed
        highest = f"of the {N_CLUSTERS} clusters' shares; at most {np.log(N_CLUSTERS):.2f}"
        size = "mean distance of the 63-D keypoints to their cluster's centre"
        shown = {"section": FIELD, "headline": True, "per_grasp": False, "of_hand_alone": True}
        self.metrics = (
            Metric("diversity", "entropy", "nats", highest, "higher", **shown),
            Metric("diversity", "cluster_size", "cm", size, "higher", **shown),
        )

    @classmethod
    def of(cls, inputs: EvaluationInputs) -> Self:
        return cls(inputs.labels, inputs.config.draws, inputs.config.seed)

    def __call__(self, method: Method) -> dict[str, Estimate]:
        points = [self.labels.keypoints(hands) for hands in method.hands.values()]
        if any(p is None for p in points):
            return {}
        clusters = cluster(self.coordinates(np.concatenate(points)), self.seed)
        if clusters is None:
            return {}

        def of_shares(index: np.ndarray) -> float:
            return float(entropy(np.bincount(clusters.label[index])))

        return {
            "entropy": statistic(len(clusters.label), of_shares, self.draws, self.seed),
            "cluster_size": mean([clusters.distance], self.draws, self.seed),
        }

    def coordinates(self, keypoints: np.ndarray) -> np.ndarray:
        """(N, 63) what is clustered: keypoints (N, 21, 3) metres in each hand's own frame, in cm."""
        return 100 * keypoints.reshape(len(keypoints), -1)


class WhitenedDiversity(Diversity):
    """The same of whitened keypoints: each coordinate in its standard deviations over these hands (ref. 9)."""

    name = "volco"

    def __init__(self, labels: HandLabels, draws: int, seed: int):
        super().__init__(labels, draws, seed)
        highest = f"of the shares of {N_CLUSTERS} clusters of whitened keypoints; at most {np.log(N_CLUSTERS):.2f}"
        size = "mean distance of the whitened keypoints to their cluster's centre, in standard deviations"
        shown = {"section": VOLCO, "per_grasp": False, "of_hand_alone": True}
        self.metrics = (
            Metric("volco", "entropy", "nats", highest, "higher", **shown),
            Metric("volco", "cluster_size", "", size, "higher", **shown),
        )

    def coordinates(self, keypoints: np.ndarray) -> np.ndarray:
        """(N, 63) of keypoints (N, 21, 3); 0 where all hands agree."""
        flat = keypoints.reshape(len(keypoints), -1)
        spread = flat.std(0)
        moves = spread > 1e-9
        return np.where(moves, (flat - flat.mean(0)) / np.where(moves, spread, 1), 0)


class Novelty(PerObject):
    """How new a posture is, wherever the hand is: distance to the nearest training grasp's keypoints.

    Args:
        labels: of the hand model.
        training: (M, 21, 3) keypoints of training grasps, as `HandLabels.keypoints` gives them.
    """

    name = "novelty"
    metrics = (
        Metric(
            *("novelty", "distance", "cm"),
            "mean distance of the 21 keypoints to those of the nearest training grasp",
            section=HAND,
            distribution=True,
            of_hand_alone=True,
        ),
    )

    def __init__(self, labels: HandLabels, training: np.ndarray):
        self.labels = labels
        self.training = training

    @classmethod
    def of(cls, inputs: EvaluationInputs) -> Self:
        return cls(inputs.labels, inputs.training_keypoints)

    def __call__(self, grasps: MeasuredGrasps) -> dict[str, np.ndarray]:
        points = self.labels.keypoints(grasps.hands)
        return {} if points is None else {"distance": novelty(points, self.training)}


class Coverage(PerObject):
    """Which of the object's held-out true grasps are the nearest one of some grasp."""

    name = "coverage"
    metrics = (
        Metric(
            *("coverage", "reached", "%"),
            "held-out true grasps that are the nearest one of some grasp",
            "higher",
            section=HAND,
            headline=True,
            per_grasp=False,
        ),
    )

    def __call__(self, grasps: MeasuredGrasps) -> dict[str, np.ndarray]:
        nearest = grasps.results["table2/nearest"]
        return {"reached": reached(nearest, held_out(grasps.truth).sum())} if (nearest >= 0).any() else {}


class Clusters(NamedTuple):
    """label (N,) of each hand's cluster, and distance (N,) to its centre."""

    label: np.ndarray
    distance: np.ndarray


def cluster(points: np.ndarray, seed: int, k: int = N_CLUSTERS) -> Clusters | None:
    """Return clusters of hands, all objects together, by k-means (ref. 9).

    Args:
        points: (N, D) coordinates.
        seed: of k-means.
        k: clusters.

    Returns:
        None where there are fewer hands than clusters.
    """
    from sklearn.cluster import KMeans  # here: an extra, which only evaluation needs

    if len(points) < k:
        return None
    fitted = KMeans(k, n_init=10, random_state=seed).fit(points)
    return Clusters(fitted.labels_, np.linalg.norm(points - fitted.cluster_centers_[fitted.labels_], axis=1))


def novelty(keypoints: np.ndarray, training: np.ndarray) -> np.ndarray:
    """Return (N,) cm: mean distance between the keypoints of each hand and those of the nearest training hand.

    Args:
        keypoints: (N, 21, 3) metres, in each hand's own frame.
        training: (M, 21, 3), likewise.
    """
    total = np.zeros((len(keypoints), len(training)))
    for k in range(keypoints.shape[1]):
        total += cdist(keypoints[:, k], training[:, k])
    return 100 * total.min(1) / keypoints.shape[1]


def reached(nearest: np.ndarray, n_held_out: int) -> np.ndarray:
    """Return (n_held_out,): 1 for each held-out true grasp of an object whose number is in `nearest` (N,)."""
    return np.isin(np.arange(n_held_out), nearest).astype(float)
