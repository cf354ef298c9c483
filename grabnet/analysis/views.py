"""Set viewpoints of a body at rest, and pictures from there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from grabnet.analysis.data_set import Surface
from grabnet.body.skeleton import HEAD_PARTS, LEFT_HAND_PARTS, PARTS, RIGHT_HAND_PARTS
from grabnet.visual.pictures import Shape, render


class View(NamedTuple):
    """A picture of the body at rest: the parts seen, whose frames count, direction to the viewer, what points up."""

    parts: Sequence[int]
    of: str
    direction: Sequence[float]
    up: Sequence[float]


# SMPL-X at rest stands with y up and looks along z; its arms lie along x, palms down.
VIEWS = {
    "body front": View(tuple(range(1, len(PARTS) + 1)), "frames", (0, 0.15, 1), (0, 1, 0)),
    "body back": View(tuple(range(1, len(PARTS) + 1)), "frames", (0, 0.15, -1), (0, 1, 0)),
    "right palm": View(RIGHT_HAND_PARTS, "right hand", (0, -1, 0), (-1, 0, 0)),
    "right back": View(RIGHT_HAND_PARTS, "right hand", (0, 1, 0), (-1, 0, 0)),
    "left palm": View(LEFT_HAND_PARTS, "left hand", (0, -1, 0), (1, 0, 0)),
    "left back": View(LEFT_HAND_PARTS, "left hand", (0, 1, 0), (1, 0, 0)),
    "head": View(HEAD_PARTS, "head", (0.5, 0.1, 1), (0, 1, 0)),
}


def on_view(surface: Surface, view: str) -> np.ndarray:
    """(V,) bool: vertices of the parts that a view shows."""
    return np.isin(surface.parts, VIEWS[view].parts)


def shows(surface: Surface, view: str) -> bool:
    """Whether a surface has what a view shows; a hand alone is no body."""
    is_hand = np.isin(surface.parts, RIGHT_HAND_PARTS).all()
    return bool(on_view(surface, view).any()) and not (is_hand and VIEWS[view].of == "frames")


def cut(surface: Surface, view: str, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices and faces of the parts that a view shows, and the values (V, …) of these vertices."""
    faces = surface.faces[on_view(surface, view)[surface.faces].all(1)]
    used, faces = np.unique(faces, return_inverse=True)
    return surface.vertices[used], faces.reshape(-1, 3), values[used]


def tile(surface: Surface, view: str, colours: np.ndarray, size: tuple[int, int] = (220, 220)) -> np.ndarray:
    """Picture of a body whose vertices have colours (V, 3), of a size in pixels."""
    return render([Shape(*cut(surface, view, colours))], VIEWS[view].direction, VIEWS[view].up, size)
