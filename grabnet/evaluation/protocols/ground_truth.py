"""Protocol `table2` (paper Table 2): how near each grasp is to the closest ground-truth grasp of the same object."""

from __future__ import annotations

from typing import Self

import numpy as np

from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.metrics import Metric, Section
from grabnet.evaluation.protocol import MeasuredGrasps, PerGrasp, PerObject
from grabnet.evaluation.protocols.contact_maps import ContactMaps
from grabnet.evaluation.recorded import held_out, same_sequence
from grabnet.evaluation.scene import GraspScene
from grabnet.geometry.mesh import vertex_areas

_CLOSEST = Section(
    "Closest ground truth",
    "Ground truth is compared with the ground truth of other recordings. The published figures are of other grasps and "
    "other object meshes.",
)


class ClosestHand(PerGrasp):
    """Distance to the closest ground-truth hand.

    vertices: mean Euclidean distance between corresponding vertices of the grasp and of a ground-truth hand, both in
    the object's frame and each in its own shape; of all ground-truth hands of the object the closest; cm. The mean
    over the first 100 grasps of an object is Table 2's "vertices". A grasp that is ground truth itself is compared
    with those of other recordings only. nearest: number of the closest among the held-out ones, -1 where there is none.
    Missing for hands that have not the ground truth's vertices.

    Args:
        samples: grasps per object that count.
    """

    name = "table2"
    needs_truth = True

    def __init__(self, samples: int = 100):
        about = "mean vertex distance to the closest ground-truth hand"
        self.metrics = (
            Metric("table2", "vertices", "cm", about, "lower", samples, _CLOSEST, headline=True, distribution=True),
        )

    @classmethod
    def of(cls, inputs: EvaluationInputs) -> Self:
        return cls(inputs.config.vertex_samples)

    def __call__(self, scene: GraspScene) -> dict[str, np.ndarray]:
        n, truth = len(scene.hands), scene.truth
        vertices, nearest = np.full(n, np.nan), np.full(n, -1)
        if scene.hands.vertices.shape[1:] == truth.vertices.shape[1:]:
            held, excluded = held_out(truth), same_sequence(scene.hands, truth)
            for i, hand in enumerate(scene.hands.vertices):
                distance = np.linalg.norm(truth.vertices - hand, axis=-1).mean(1, dtype=np.float64)
                if held.any():
                    nearest[i] = distance[held].argmin()
                distance[excluded[i]] = np.inf
                vertices[i] = 100 * distance.min() if np.isfinite(distance).any() else np.nan
        return {"vertices": vertices, "nearest": nearest}


class ClosestMap(PerObject):
    """Difference to the closest ground-truth contact map: `closest_map_error`; Table 2's "contact".

    Args:
        samples: grasps per object that are measured (20 in the paper).
    """

    name = "table2"
    of_truth = (ContactMaps,)

    def __init__(self, samples: int = 20):
        self.samples = samples
        about = "share of the object's surface labelled otherwise than in the closest ground-truth contact map"
        self.metrics = (Metric("table2", "contact", "%", about, "lower", samples, _CLOSEST, headline=True),)

    @classmethod
    def of(cls, inputs: EvaluationInputs) -> Self:
        return cls(inputs.config.contact_samples)

    def __call__(self, grasps: MeasuredGrasps) -> dict[str, np.ndarray]:
        first = slice(self.samples)
        error = closest_map_error(
            grasps.results["maps/object"][first] > 0,
            grasps.truth_results["maps/object"] > 0,
            vertex_areas(grasps.mesh.vertices, grasps.mesh.faces),
            same_sequence(grasps.hands.select(first), grasps.truth),
        )
        return {"contact": error}


def closest_map_error(maps: np.ndarray, reference: np.ndarray, weights: np.ndarray, excluded: np.ndarray) -> np.ndarray:
    """Return (N,) the error of contact maps against the closest of the ground truth's, a share.

    Both are binary: 1 where a vertex of the object is touched. The error of a map is the share of the object's surface
    on which the two differ, each vertex standing for a third of the area of its faces; that of a grasp is the smallest
    over the ground-truth maps of the object. The mean over the first 20 grasps of an object is Table 2's figure.

    Args:
        maps: (N, V) bool.
        reference: (M, V) bool, of the ground truth.
        weights: (V,) area of each vertex.
        excluded: (N, M) bool, which not to compare; NaN where none is left.
    """
    weights = (weights / weights.sum()).astype(np.float64)
    a, b = maps.astype(np.float64), reference.astype(np.float64)
    error = (a @ weights)[:, None] + b @ weights - 2 * (a * weights) @ b.T
    error = np.where(excluded, np.inf, np.maximum(error, 0)).min(1, initial=np.inf)
    return np.where(np.isfinite(error), error, np.nan)
