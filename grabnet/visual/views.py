"""From where to look at a hand on an object."""

from __future__ import annotations

import numpy as np

from grabnet.visual.pictures import Shape, render_views


def both_sides(solid: Shape, hand: Shape, up: np.ndarray, across: np.ndarray, size: int) -> np.ndarray:
    """A hand on an object from the hand's left and right, somewhat from above: neither hides the other.

    Args:
        up: (3,) of length 1.
        across: (3,) horizontal, to look along where the hand is right above or below the object.
        size: pixels of each of the two square views.

    Returns:
        uint8 (size, 2 size, 3).
    """
    reach = np.asarray(hand.vertices).mean(0) - np.asarray(solid.vertices).mean(0)
    sideways = np.cross(up, reach)
    if np.linalg.norm(sideways) < 0.1 * np.linalg.norm(reach):
        sideways = across
    sideways = sideways / np.linalg.norm(sideways)
    views = render_views([solid, hand], [sign * sideways + 0.4 * up for sign in (1, -1)], up, (size, size))
    return np.concatenate(views, 1)
