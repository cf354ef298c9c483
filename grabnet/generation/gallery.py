"""A contact sheet of grasps: each from its two sides, captioned with what was measured."""

from __future__ import annotations

import numpy as np

from grabnet.body.anatomy import FINGERS
from grabnet.generation.grasps import Grasps
from grabnet.visual.pictures import OBJECT, SKIN, Shape, contact_sheet, render_views


def grasp_sheet(grasps: Grasps, size: int = 280) -> np.ndarray:
    """All grasps of a batch; uint8 (H, W, 3).

    Args:
        size: pixels of each of the two square views.
    """
    solid = Shape(grasps.mesh.vertices, grasps.mesh.faces, OBJECT)
    tiles, captions = [], []
    for hand, record in zip(grasps.vertices.numpy(), grasps.report(), strict=True):
        tiles.append(both_sides(solid, Shape(hand, grasps.faces, SKIN), grasps.up, grasps.to_object[1, :3], size))
        touching = [finger for finger in FINGERS if record["contact_vertices"][finger]]
        captions.append(f"{record['index']}: {record['max_penetration_mm']:.1f} mm deep · {_listed(touching)}")
    return contact_sheet(tiles, captions)


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


def _listed(fingers: list[str]) -> str:
    return "no finger touches" if not fingers else "all fingers touch" if fingers == [*FINGERS] else " ".join(fingers)
