"""A hand as convex solids that move with its bones."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

# A vertex belongs to every phalanx that has at least this share of its skinning weight, so that neighbours overlap.
_SHARE = 0.35
# The palm is cut into so many tiles along and across, which overlap by so many metres.
_TILES = (5, 3)
_OVERLAP = 0.005
# Fewest vertices of a solid: of a phalanx, of a tile.
_FEWEST, _FEWEST_OF_TILE = 4, 8


def hand_pieces(weights: np.ndarray, rest: np.ndarray) -> list[np.ndarray]:
    """Vertex sets whose convex hulls make up the hand: a phalanx each, and the palm in tiles.

    One hull around the palm would fill its hollow, and the space between it and the thumb.

    Args:
        weights: (V, 16) skinning weights, the wrist's first, as in MANO's schema.
        rest: (V, 3) metres, the hand at rest, flat in the plane of x and z as MANO is.
    """
    bone = weights.argmax(1)
    phalanges = [np.where((bone == j) | (weights[:, j] > _SHARE))[0] for j in range(1, weights.shape[1])]
    pieces = [piece for piece in phalanges if len(piece) >= _FEWEST]
    palm = np.where(bone == 0)[0]
    x, z = rest[palm][:, [0, 2]].T
    along, across = (np.linspace(v.min(), v.max(), n + 1) for v, n in zip((x, z), _TILES, strict=True))
    for x0, x1 in pairwise(along):
        for z0, z1 in pairwise(across):
            inside = (x >= x0 - _OVERLAP) & (x < x1 + _OVERLAP) & (z >= z0 - _OVERLAP) & (z < z1 + _OVERLAP)
            if inside.sum() >= _FEWEST_OF_TILE:
                pieces.append(palm[inside])
    return pieces
