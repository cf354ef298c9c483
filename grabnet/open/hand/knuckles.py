"""Knuckles where people have them: MakeHuman's finger roots sit at the web line, a centimetre too far out."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from grabnet.open.hand.flatten import FlatHands

KNUCKLES = (1, 4, 7, 10)  # first joints of index, middle, pinky, ring
THUMB = slice(13, 16)


def move_knuckles(
    hands: FlatHands, proximal: float = 0.010, dorsal: float = 0.0025, blend: tuple[float, float] = (0.009, 0.013)
) -> FlatHands:
    """Move the four knuckle joints towards the wrist and solve the skin weights around them again.

    A vertex follows a finger by (which finger) × (how far beyond its knuckle). Which finger: one-hot on the shafts, and
    the harmonic function on the mesh between them, so the webs and the palm pass smoothly from finger to finger.
    How far: a smooth step along the finger across the knuckle's plane. Joints further out keep their weights.

    Args:
        proximal, dorsal: metres by which the joints move.
        blend: half-width of the step at the back of the hand and on the palm, metres: the back is tight, so that the
            knuckle keeps its shape; the palm is soft, where flesh folds.
    """
    joints = hands.joints.copy()
    joints[:, KNUCKLES] += (proximal, dorsal, 0)
    vertices, mean_joints = hands.vertices.mean(0), joints.mean(0)
    share = finger_shares(vertices, hands.faces, hands.weights)
    thumb = hands.weights[:, THUMB].sum(1)
    weights = hands.weights.copy()
    for f, knuckle in enumerate(KNUCKLES):
        along = mean_joints[knuckle + 2] - mean_joints[knuckle]
        along /= np.linalg.norm(along)
        offset = vertices - mean_joints[knuckle]
        palmar = smooth_step((0.008 - offset[:, 1]) / 0.016)  # 0 at the back of the hand, 1 on the palm
        width = blend[0] + (blend[1] - blend[0]) * palmar
        finger = (1 - thumb) * share[:, f] * smooth_step((offset @ along / width + 1) / 2)
        outer = hands.weights[:, knuckle + 1 : knuckle + 3]
        outer = outer * np.minimum(1, finger / np.maximum(outer.sum(1), 1e-9))[:, None]
        weights[:, knuckle + 1 : knuckle + 3] = outer
        weights[:, knuckle] = finger - outer.sum(1)
    weights[:, 0] = 1 - weights[:, 1:].sum(1)
    weights = np.where(weights < 1e-4, 0, weights)
    return FlatHands(hands.vertices, hands.faces, joints, weights / weights.sum(1, keepdims=True))


def finger_shares(vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(V, 4) which of index, middle, pinky, ring a vertex belongs to: harmonic between shafts, rows sum to 1."""
    fingers = np.stack([weights[:, k : k + 3].sum(1) for k in KNUCKLES], 1)
    fixed = fingers.max(1) > 0.9
    n = len(vertices)
    a, b = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1).T
    closeness = 1 / np.linalg.norm(vertices[a] - vertices[b], axis=1)
    graph = sparse.coo_matrix((closeness, (a, b)), (n, n)).tocsr()
    graph = graph + graph.T
    laplacian = sparse.diags(np.asarray(graph.sum(1)).ravel()) - graph
    share = np.zeros((n, 4))
    share[fixed] = np.eye(4)[fingers[fixed].argmax(1)]
    free = ~fixed
    share[free] = spsolve(laplacian[free][:, free].tocsc(), -(laplacian[free][:, fixed] @ share[fixed]))
    return share


def smooth_step(x: np.ndarray) -> np.ndarray:
    """0 below 0, 1 above 1, with zero slope at both."""
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)
