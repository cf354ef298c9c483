"""Placing a layout on a body by the names of anatomical places."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
import trimesh

from grabnet.body.whole import BodyModel
from grabnet.mosh.layouts import Attached, Layout
from grabnet.mosh.places import Skin
from grabnet.visual.pictures import Shape

TYPE_COLORS = {"body": (0.16, 0.38, 0.72), "face": (0.85, 0.45, 0.1), "finger": (0.15, 0.6, 0.3)}


def place_layout(
    name: str, body: BodyModel, places: Mapping[str, Mapping[str, str]], v_template: torch.Tensor | None = None
) -> tuple[Layout, dict[str, str]]:
    """Markers at anatomical places of a body.

    Args:
        name: of the layout.
        body: any model in SMPL-X's schema.
        places: of each type of marker, label → place; `grabnet.mosh.places.PLACES` are known.
        v_template: (V, 3) of a subject.

    Returns:
        the layout, and the place of each label.

    Raises:
        UserError: an unknown place.
    """
    skin = Skin(body, v_template)
    markers = tuple(
        Attached.at(label, type_, skin.vertex(place))
        for type_, those in places.items()
        for label, place in those.items()
    )
    comments = {label: place.replace("_", " ") for those in places.values() for label, place in those.items()}
    return Layout(name, len(skin.vertices), markers), comments


def marker_positions(layout: Layout, vertices: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(..., M, 3) where the layout's markers are on bodies of vertices and normals (..., V, 3)."""
    corners = np.array([marker.vertices for marker in layout.markers])
    weights = np.array([marker.weights for marker in layout.markers])[..., None]
    distance = np.array([marker.distance for marker in layout.markers])[:, None]
    skin = (vertices[..., corners, :] * weights).sum(-2)
    normal = (normals[..., corners, :] * weights).sum(-2)
    return skin + distance * normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def balls(places: np.ndarray, radii: np.ndarray, colors: np.ndarray) -> Shape:
    """One shape of M balls at places (M, 3), of radii (M,) and colours (M, 3)."""
    ball = trimesh.creation.icosphere(1, 1.0)
    vertices = (places[:, None] + radii[:, None, None] * ball.vertices).reshape(-1, 3)
    faces = (ball.faces + len(ball.vertices) * np.arange(len(places))[:, None, None]).reshape(-1, 3)
    return Shape(vertices, faces, np.repeat(colors, len(ball.vertices), 0))
