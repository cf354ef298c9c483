"""Right hands of random adults, cut from their bodies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grabnet.open.body.source import AdultBodies, sample_bodies

BONES = (
    "lowerarm01",
    "lowerarm02",
    "wrist",
    *(f"metacarpal{k}" for k in (1, 2, 3, 4)),
    *(f"finger{finger}-{k}" for finger in (1, 2, 3, 4, 5) for k in (1, 2, 3)),
)


@dataclass(frozen=True)
class AdultHands:
    """N hands as modelled: slightly curled, at the end of a hanging arm. Metres, z up, body frame.

    vertices (N, V, 3); faces (F, 3); heads and tails (N, len(BONES), 3) of the `BONES`; weights (V, len(BONES)).
    """

    vertices: np.ndarray
    faces: np.ndarray
    heads: np.ndarray
    tails: np.ndarray
    weights: np.ndarray


def sample_adults(n: int, seed: int, forearm: float = 0.015) -> AdultHands:
    """Hands of `n` random adults; see `cut_hands`.

    Raises:
        UserError: anny isn't installed.
    """
    return cut_hands(sample_bodies(n, seed), forearm)[1]


def cut_hands(bodies: AdultBodies, forearm: float = 0.015) -> tuple[np.ndarray, AdultHands]:
    """Right hands, cut along a ring of edges at least `forearm` metres behind the wrist joint.

    Returns:
        ids (V,) of their vertices among the bodies', and the hands.
    """
    bones = [bodies.bones.index(f"{name}.R") for name in BONES]
    wrist, middle = (bodies.heads[:, bodies.bones.index(name)].mean(0) for name in ("wrist.R", "finger3-1.R"))
    backward = (wrist - middle) / np.linalg.norm(wrist - middle)
    kept, faces = _grow(
        bodies.faces,
        bodies.right_hand,
        lambda loop: (bodies.vertices[:, loop].mean((0, 1)) - wrist) @ backward > forearm,
    )
    weights = bodies.weights[kept][:, bones]
    weights = weights / weights.sum(1, keepdims=True)
    return kept, AdultHands(bodies.vertices[:, kept], faces, bodies.heads[:, bones], bodies.tails[:, bones], weights)


def _grow(faces: np.ndarray, start: list[int], far_enough) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and renumbered faces of the patch around `start`, grown by rings until its boundary is far enough."""
    inside = np.zeros(faces.max() + 1, bool)
    inside[start] = True
    while True:
        patch = faces[inside[faces].all(1)]
        edges = np.sort(patch[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1)
        unique, count = np.unique(edges, axis=0, return_counts=True)
        if far_enough(np.unique(unique[count == 1])):
            kept = np.unique(patch)
            return kept, np.searchsorted(kept, patch)
        inside[faces[inside[faces].any(1)]] = True
