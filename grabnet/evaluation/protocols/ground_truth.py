"""Protocol `table2` (paper Table 2): how near each grasp is to the closest ground-truth grasp of the same object."""

from __future__ import annotations

import numpy as np
import torch

from grabnet.body.hand import HandModel
from grabnet.data.frames import FramesStore
from grabnet.evaluation.hands import Hands
from grabnet.evaluation.metrics import Metric
from grabnet.evaluation.scene import Scene
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.io.files import sha256

# Hands posed at once.
_BATCH = 256


@torch.no_grad()
def recorded_hands(store: FramesStore, hand: HandModel, name: str, mesh: Mesh, most: int | None = None) -> Hands:
    """The recorded grasps of one object, each in its subject's shape, in the frame of the object's mesh.

    Args:
        most: so many of them, evenly spaced, where there are more.
    """
    index = (store.frames.object == store.objects.index(name)).nonzero().squeeze(1)
    if most is not None and most < len(index):
        index = index[torch.linspace(0, len(index) - 1, most).long()]
    vertices, poses = [], []
    for part in index.split(_BATCH):
        frames = store.frames.select(part)
        parameters = frames.hand()
        posed = hand(parameters, store.v_template[frames.subject]).vertices
        vertices.append(posed @ axis_angle_to_matrix(frames.object_orient) + torch.as_tensor(mesh.centroid))
        poses.append(parameters.hand_pose)
    return Hands(
        vertices=torch.cat(vertices).numpy(),
        faces=hand.faces.numpy(),
        hand_pose=torch.cat(poses).numpy(),
        sequences=store.frames.sequence[index].numpy(),
    )


def held_out(reference: Hands) -> np.ndarray:
    """(M,) bool: every other recording. The rest is what a row of ground truth is drawn from, so that the two never
    share a recording, whose frames may hardly differ."""
    recordings = np.unique(reference.sequences)
    return np.isin(reference.sequences, recordings[1::2])


def ground_truth_row(reference: Hands, n: int, seed: int) -> Hands:
    """Up to n recorded grasps at random, none of them held out."""
    candidates = (~held_out(reference)).nonzero()[0]
    return reference.select(np.random.default_rng([seed, 2]).permutation(candidates)[:n])


class ClosestHand:
    """Distance to the closest ground-truth hand.

    vertices: mean Euclidean distance between corresponding vertices of the grasp and of a ground-truth hand, both in
    the object's frame and each in its own shape; of all ground-truth hands of the object the closest; cm. The mean
    over the first 100 grasps of an object is Table 2's "vertices". A grasp that is ground truth itself is compared
    with those of other recordings only. nearest: which of the held-out ones is closest, for `coverage`. Missing for
    hands that have not the ground truth's vertices.

    Args:
        reference: ground truth. samples: grasps per object that count.
    """

    name = "table2"

    def __init__(self, reference: Hands, samples: int = 100):
        self.reference = reference
        self.held_out = held_out(reference).nonzero()[0]
        self.settings = sha256(*reference.keys)
        about = "mean vertex distance to the closest ground-truth hand"
        self.metrics = (Metric("table2", "vertices", "cm", about, "lower", samples),)

    def __call__(self, scene: Scene) -> dict[str, np.ndarray]:
        n = len(scene.hands)
        found = {"vertices": np.full(n, np.nan), "nearest": np.full(n, -1)}
        if scene.hands.vertices.shape[1:] != self.reference.vertices.shape[1:]:
            return found
        excluded = same_sequence(scene.hands, self.reference)
        for i, hand in enumerate(scene.hands.vertices):
            distance = np.linalg.norm(self.reference.vertices - hand, axis=-1).mean(1, dtype=np.float64)
            if len(self.held_out):
                found["nearest"][i] = distance[self.held_out].argmin()
            distance[excluded[i]] = np.inf
            found["vertices"][i] = 100 * distance.min() if np.isfinite(distance).any() else np.nan
        return found


CLOSEST_MAP = "share of the object's surface labelled otherwise than in the closest ground-truth contact map"


def closest_map_error(maps: np.ndarray, reference: np.ndarray, weights: np.ndarray, excluded: np.ndarray) -> np.ndarray:
    """(N,) error of contact maps (N, V) against the closest of the ground truth's (M, V), a share: Table 2's "contact".

    Both are binary: 1 where a vertex of the object is touched. The error of a map is the share of the object's surface
    on which the two differ, each vertex standing for a third of the area of its faces; that of a grasp is the smallest
    over the ground-truth maps of the object. The mean over the first 20 grasps of an object is Table 2's figure.

    Args:
        weights: (V,) area of each vertex.
        excluded: (N, M) bool, which not to compare; NaN where none is left.
    """
    weights = (weights / weights.sum()).astype(np.float64)
    a, b = maps.astype(np.float64), reference.astype(np.float64)
    error = (a @ weights)[:, None] + b @ weights - 2 * (a * weights) @ b.T
    error = np.where(excluded, np.inf, np.maximum(error, 0)).min(1, initial=np.inf)
    return np.where(np.isfinite(error), error, np.nan)


def same_sequence(hands: Hands, reference: Hands) -> np.ndarray:
    """(N, M) bool: which of the reference are of the same recording as each hand."""
    if hands.sequences is None:
        return np.zeros((len(hands), len(reference)), bool)
    return hands.sequences[:, None] == reference.sequences
