"""A contact sheet of grasps: each from its two sides, captioned with what was measured."""

from __future__ import annotations

import numpy as np

from grabnet.body.anatomy import FINGERS
from grabnet.grasps import Grasps
from grabnet.visual.pictures import OBJECT, SKIN, Shape, contact_sheet, render_views


def grasp_sheet(grasps: Grasps, size: int = 280) -> np.ndarray:
    """All grasps of a batch; uint8 (H, W, 3).

    Args:
        size: pixels of each of the two square views.
    """
    solid = Shape(grasps.mesh.vertices, grasps.mesh.faces, OBJECT)
    tiles, captions = [], []
    for hand, record in zip(grasps.vertices.numpy(), grasps.report(), strict=True):
        shapes = [solid, Shape(hand, grasps.faces, SKIN)]
        tiles.append(np.concatenate(render_views(shapes, _sides(grasps, hand), grasps.up, (size, size)), 1))
        touching = [finger for finger in FINGERS if record["contact_vertices"][finger]]
        captions.append(f"{record['index']}: {record['max_penetration_mm']:.1f} mm deep · {_listed(touching)}")
    return contact_sheet(tiles, captions)


def _listed(fingers: list[str]) -> str:
    return "no finger touches" if not fingers else "all fingers touch" if fingers == [*FINGERS] else " ".join(fingers)


def _sides(grasps: Grasps, hand: np.ndarray) -> list[np.ndarray]:
    """Directions to the viewer from the hand's left and right, somewhat from above: neither hides the other."""
    reach = hand.mean(0) - grasps.mesh.centroid
    across = np.cross(grasps.up, reach)
    if np.linalg.norm(across) < 0.1 * np.linalg.norm(reach):  # the hand is right above or below
        across = grasps.to_object[1, :3]
    across = across / np.linalg.norm(across)
    return [sign * across + 0.4 * grasps.up for sign in (1, -1)]
