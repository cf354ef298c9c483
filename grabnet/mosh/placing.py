"""Placing a layout on a body by the names of anatomical places, and drawing it."""

from __future__ import annotations

import html
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
import trimesh

from grabnet.body.whole import BodyModel
from grabnet.io.files import write_bytes
from grabnet.mosh.layouts import Attached, Layout
from grabnet.mosh.places import Skin
from grabnet.visual.pictures import SKIN, Shape, can_render, contact_sheet, render_views, save_image

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


def draw_layout(path: Path, layout: Layout, body: BodyModel, positions: np.ndarray) -> str | None:
    """Draw the layout as a picture, and write a page with it and the list of markers beside it.

    Args:
        path: `.png`; the page has the same name and ends in `.html`.
        positions: (M, 3) of the markers on the body at rest.

    Returns:
        why there is no picture; None where there is one.
    """
    if reason := can_render():
        return reason
    radii = np.where(layout.types == "body", 0.009, 0.003)
    markers = balls(positions, radii, np.array([TYPE_COLORS[marker.type] for marker in layout.markers]))
    skin = Shape(body.v_template.numpy(), body.faces.numpy(), SKIN)
    views = render_views([skin, markers], [(0.15, 0.1, 1), (-0.15, 0.1, -1), (0, 1, 0.15)], (0, 1, 0), (700, 700))
    save_image(path, contact_sheet(views, ["from ahead", "from behind", "from above"], 3))
    rows = "".join(
        f"<tr><td>{html.escape(m.label)}<td>{m.type}<td>{m.vertices[0]}<td>{1e3 * m.distance:g} mm</tr>"
        for m in layout.markers
    )
    page = (
        f"<!doctype html><meta charset=utf-8><title>{html.escape(layout.name)}</title>"
        "<style>body{font-family:sans-serif;margin:2em}td{padding:.1em 1em}</style>"
        f"<h1>{html.escape(layout.name)}: {len(layout.markers)} markers</h1>"
        f"<img src='{html.escape(path.name)}' width='100%'>"
        f"<table><tr><th>label<th>type<th>vertex<th>distance</tr>{rows}</table>"
    )
    write_bytes(path.with_suffix(".html"), page.encode())
    return None


def balls(places: np.ndarray, radii: np.ndarray, colors: np.ndarray) -> Shape:
    """One shape of M balls at places (M, 3), of radii (M,) and colours (M, 3)."""
    ball = trimesh.creation.icosphere(1, 1.0)
    vertices = (places[:, None] + radii[:, None, None] * ball.vertices).reshape(-1, 3)
    faces = (ball.faces + len(ball.vertices) * np.arange(len(places))[:, None, None]).reshape(-1, 3)
    return Shape(vertices, faces, np.repeat(colors, len(ball.vertices), 0))
