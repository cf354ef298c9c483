"""The report's pictures: grasps with what they touch, and where objects are touched most."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from grabnet.evaluation.cache import Cache
from grabnet.evaluation.colours import blended
from grabnet.evaluation.hands import Hands
from grabnet.geometry.mesh import Mesh
from grabnet.visual.pictures import OBJECT, SKIN, Shape, render

SIZE = 300  # pixels, drawn larger than shown
_UP = np.array([0.0, 0.0, 1.0])


def grasp_view(mesh: Mesh, hands: Hands, index: int, touched: np.ndarray, cache: Cache) -> bytes:
    """Return a JPEG of one grasp from beside the hand, somewhat from above; the object is red where `touched` (V,)."""
    vertices = hands.vertices[index]
    reach = vertices.mean(0) - mesh.centroid
    side = np.cross(_UP, reach)
    if np.linalg.norm(side) < 0.1 * np.linalg.norm(reach):
        side = np.array([0.0, 1.0, 0.0])
    direction = side / np.linalg.norm(side) + 0.4 * _UP
    shapes = [Shape(mesh.vertices, mesh.faces, blended(OBJECT, touched)), Shape(vertices, hands.faces, SKIN)]
    return _drawn(shapes, direction, cache)


def heat_view(mesh: Mesh, share: np.ndarray, cache: Cache) -> bytes:
    """Return a JPEG of the object, the redder the larger the share (V,) of grasps that touch there."""
    return _drawn([Shape(mesh.vertices, mesh.faces, blended(OBJECT, share))], np.array([-0.45, -1.0, 0.45]), cache)


def _drawn(shapes: list[Shape], direction: np.ndarray, cache: Cache) -> bytes:
    def draw() -> dict[str, np.ndarray]:
        buffer = io.BytesIO()
        Image.fromarray(render(shapes, direction, _UP, (SIZE, SIZE))).save(buffer, "JPEG", quality=85)
        return {"jpeg": np.frombuffer(buffer.getvalue(), np.uint8)}

    key = [np.asarray(part) for shape in shapes for part in (shape.vertices, shape.faces, np.asarray(shape.color))]
    return cache.get("picture", [*key, np.asarray(direction, float), str(SIZE)], draw)["jpeg"].tobytes()
