"""A contact sheet of grasps: each from its two sides, captioned with what was measured."""

from __future__ import annotations

import numpy as np

from grabnet.cli.progress import track
from grabnet.generation.captions import caption
from grabnet.generation.grasps import Grasps
from grabnet.visual.pictures import OBJECT, SKIN, Shape, contact_sheet
from grabnet.visual.views import both_sides


def grasp_sheet(grasps: Grasps, size: int = 280) -> np.ndarray:
    """All grasps of a batch; uint8 (H, W, 3).

    Args:
        size: pixels of each of the two square views.
    """
    solid = Shape(grasps.mesh.vertices, grasps.mesh.faces, OBJECT)
    tiles, captions = [], []
    shown = zip(grasps.vertices.numpy(), grasps.report(), strict=True)
    for hand, record in track(shown, "Drawing pictures", len(grasps)):
        tiles.append(both_sides(solid, Shape(hand, grasps.faces, SKIN), grasps.up, grasps.to_object[1, :3], size))
        captions.append(f"{record['index']}: {caption(record)}")
    return contact_sheet(tiles, captions)
