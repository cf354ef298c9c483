"""The shape space: how adult hands differ, as a mean, ten directions, and joints that follow the surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from grabnet.open.hand.flatten import FlatHands
from grabnet.open.hand.knuckles import KNUCKLES, finger_shares, smooth_step


def vary(
    hands: FlatHands, seed: int, length: float = 0.035, girth: float = 0.06, breadth: float = 0.04, margin: float = 0.02
) -> FlatHands:
    """Give every hand fingers and a breadth of its own: MakeHuman scales all fingers as one.

    Args:
        length, girth, breadth: standard deviations, as shares of a finger's length and girth and the hand's breadth.
        margin: metres beyond a finger's first joint over which the change of girth sets in.
    """
    rng = np.random.default_rng(seed)
    n = len(hands.vertices)
    vertices, joints = hands.vertices.copy(), hands.joints.copy()
    thumb = hands.weights[:, 14:].sum(1)  # beyond the thumb's second joint: its base is part of the palm
    share = finger_shares(hands.vertices.mean(0), hands.faces, hands.weights) * (1 - thumb[:, None])
    for first, belongs in [*zip(KNUCKLES, share.T, strict=True), (14, thumb)]:
        last = first + (2 if first in KNUCKLES else 1)
        base = hands.joints[:, first]
        along = hands.joints[:, last] - base
        along /= np.linalg.norm(along, axis=-1, keepdims=True)
        lengthen, thicken = rng.normal(0, length, (n, 1, 1)), rng.normal(0, girth, (n, 1, 1))
        own_joints = np.zeros(16)
        own_joints[first : last + 1] = 1
        for points, weight, moved in (
            (hands.vertices, belongs, vertices), (hands.joints, own_joints, joints),
        ):  # fmt: skip
            offset = points - base[:, None]
            reach = (offset * along[:, None]).sum(-1, keepdims=True)
            outward = offset - reach * along[:, None]
            change = lengthen * np.maximum(reach, 0) * along[:, None] + thicken * smooth_step(reach / margin) * outward
            moved += weight[:, None] * change
    broaden = 1 + rng.normal(0, breadth, (n, 1))
    vertices[..., 2] *= broaden
    joints[..., 2] *= broaden
    return FlatHands(vertices, hands.faces, joints, hands.weights)


def calibrate(hands: FlatHands, mean: float = 0.189, deviation: float = 0.010) -> FlatHands:
    """Scale each hand so that lengths, wrist crease to middle fingertip, have this mean and deviation in metres.

    The figures are those of adult hands of both sexes together. The crease lies over the wrist joint, at the origin.
    """
    length = -hands.vertices[..., 0].min(1)
    target = mean + deviation * (length - length.mean()) / length.std()
    scale = (target / length)[:, None, None]
    return FlatHands(hands.vertices * scale, hands.faces, hands.joints * scale, hands.weights)


def principal_shapes(vertices: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, V, 3) → mean (V, 3), directions (V, 3, n) scaled to one standard deviation, explained shares (n,).

    The sign is chosen so that a positive beta makes the hand longer.
    """
    mean = vertices.mean(0)
    _, s, vt = np.linalg.svd((vertices - mean).reshape(len(vertices), -1), full_matrices=False)
    directions = (vt[:n] * s[:n, None] / np.sqrt(len(vertices) - 1)).reshape(n, -1, 3)
    directions *= np.where(directions[..., 0].sum(1) > 0, -1, 1)[:, None, None]
    return mean, directions.transpose(1, 2, 0), (s**2 / (s**2).sum())[:n]


def joint_regressor(
    vertices: np.ndarray,
    joints: np.ndarray,
    weights: np.ndarray,
    parents: Sequence[int],
    nearest: int = 80,
    bend: int = 1000,
) -> np.ndarray:
    """(J, V) non-negative rows summing to 1 that give the joints (N, J, 3) of the shapes (N, V, 3).

    A joint is sought by non-negative least squares among the vertices near it and, evenly chosen, some `bend` at most
    of those that bend about it.
    """
    mean = vertices.mean(0)
    tree = cKDTree(mean)
    regressor = np.zeros((joints.shape[1], vertices.shape[1]))
    for j, parent in enumerate(parents):
        near = tree.query(joints[:, j].mean(0), nearest)[1]
        bending = np.flatnonzero(np.minimum(weights[:, j], weights[:, max(parent, 0)]) > 0.1) if j else []
        chosen = np.union1d(near, bending[:: -(-len(bending) // bend) or 1]).astype(int)
        system = (vertices[:, chosen] - joints[:, j, None]).transpose(0, 2, 1).reshape(-1, len(chosen))
        ridge = 1e-3 * np.sqrt(len(system)) * np.eye(len(chosen))  # prefers many small shares to a few large ones
        system = np.concatenate([system, np.full((1, len(chosen)), 100.0), ridge])
        target = np.zeros(len(system))
        target[3 * len(vertices)] = 100
        share, _ = nnls(system, target, maxiter=20_000)
        regressor[j, chosen] = share / share.sum()
    return regressor
