"""Picture and page of a layout."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from torch import Tensor

from grabnet.body.anatomy import vertex_normals
from grabnet.body.skeleton import JOINTS, LEFT_HAND_JOINTS, RIGHT_HAND_JOINTS
from grabnet.body.whole import BodyModel
from grabnet.io.files import write_bytes
from grabnet.mosh.layouts import Attached, Layout
from grabnet.mosh.placing import TYPE_COLORS, balls, marker_positions
from grabnet.visual.pictures import SKIN, Shape, can_render, contact_sheet, render, save_image

_ALL = tuple(range(len(JOINTS)))
_HEAD = tuple(JOINTS.index(name) for name in ("head", "jaw", "left_eye", "right_eye"))
_RADII = {"body": 0.0095, "face": 0.0025, "finger": 0.0025}  # metres, as drawn
# What is drawn: the joints whose skin it is, the direction that it is seen from, and what points up.
_VIEWS = {
    "from ahead": (_ALL, (0.15, 0.1, 1), (0, 1, 0)),
    "from behind": (_ALL, (-0.15, 0.1, -1), (0, 1, 0)),
    "from the left": (_ALL, (1, 0.1, 0.1), (0, 1, 0)),
    "face": (_HEAD, (0.25, 0, 1), (0, 1, 0)),
    "right hand": (RIGHT_HAND_JOINTS, (0, 1, 0.25), (-1, 0, 0)),
    "left hand": (LEFT_HAND_JOINTS, (0, 1, 0.25), (1, 0, 0)),
}


def draw_layout(
    path: Path, layout: Layout, body: BodyModel, v_template: Tensor, places: Mapping[str, str] | None = None
) -> str | None:
    """Draw a layout as a picture, and write a page with it and the list of markers beside it.

    Args:
        path: `.png`; the page has the same name and ends in `.html`.
        layout: of the body.
        body: the model.
        v_template: (V, 3) the body at rest.
        places: what the places of labels are called, where known.

    Returns:
        why there is no picture; None where there is one.
    """
    reason = can_render()
    if reason is None:
        rest = v_template.double()
        positions = marker_positions(layout, rest.numpy(), vertex_normals(rest, body.faces).numpy())
        owner = body.weights.argmax(1).numpy()
        tiles = {
            name: _tile(layout, v_template.numpy(), body.faces.numpy(), positions, np.isin(owner, joints), view, up)
            for name, (joints, view, up) in _VIEWS.items()
        }
        shown = {name: tile for name, tile in tiles.items() if tile is not None}
        save_image(path, contact_sheet([*shown.values()], [*shown], 3))
    write_bytes(path.with_suffix(".html"), _page(path, layout, places or {}, reason).encode())
    return reason


def _tile(
    layout: Layout,
    vertices: np.ndarray,
    faces: np.ndarray,
    positions: np.ndarray,
    own: np.ndarray,
    view: Sequence[float],
    up: Sequence[float],
) -> np.ndarray | None:
    """Some of the skin, `own` (V,), and its markers; None where it has none."""
    there = own[[marker.vertices[0] for marker in layout.markers]]
    if not there.any():
        return None
    types = layout.types[there]
    colors = np.array([TYPE_COLORS[type_] for type_ in types])
    markers = balls(positions[there], np.array([_RADII[type_] for type_ in types]), colors)
    skin = Shape(vertices[own], (np.cumsum(own) - 1)[faces[own[faces].all(1)]], SKIN)
    return render([skin, markers], view, up, (700, 700))


def _page(path: Path, layout: Layout, places: Mapping[str, str], reason: str | None) -> str:
    picture = f"<img src='{html.escape(path.name)}' width='100%'>" if reason is None else f"<p>{html.escape(reason)}"
    rows = "".join(_row(marker, places.get(marker.label, "")) for marker in layout.markers)
    kinds = ", ".join(
        f"<span style='color:rgb{tuple(round(255 * c) for c in color)}'>{(layout.types == type_).sum()} {type_}</span>"
        for type_, color in TYPE_COLORS.items()
    )
    name = html.escape(layout.name)
    return (
        f"<!doctype html><meta charset=utf-8><title>{name}</title>"
        "<style>body{font-family:sans-serif;margin:2em}td,th{padding:.1em 1em;text-align:left}</style>"
        f"<h1>{name}: {len(layout.markers)} markers</h1><p>{kinds}; body model of {layout.n_vertices:,} vertices"
        f"{picture}<table><tr><th>label<th>type<th>place<th>vertex, or corners and weights<th>distance to the skin</tr>"
        f"{rows}</table>"
    )


def _row(marker: Attached, place: str) -> str:
    where = str(marker.vertices[0])
    if len(set(marker.vertices)) > 1:
        where = f"{marker.vertices}, ({', '.join(f'{weight:.3g}' for weight in marker.weights)})"
    return (
        f"<tr><td>{html.escape(marker.label)}<td>{marker.type}<td>{html.escape(place)}<td>{where}"
        f"<td>{1e3 * marker.distance:g} mm</tr>"
    )
