"""Pictures of how well a recording fits its markers: residuals over time, and a film of body, markers and residuals."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from matplotlib import colormaps
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from PIL import Image

from grabnet.body.whole import BodyModel
from grabnet.data.sequences import Sequence
from grabnet.geometry.mesh import Mesh
from grabnet.io.files import replacing
from grabnet.mosh.layouts import Layout
from grabnet.mosh.placing import TYPE_COLORS, balls
from grabnet.mosh.quality import Limits
from grabnet.mosh.synthesis import posed_vertices
from grabnet.visual.pictures import OBJECT, SKIN, Shape, can_render, contact_sheet, render

_FRAMES_PER_SECOND, _MOST_FRAMES = 15, 120
_VIEW = (1.0, -0.7, 0.45)
_TILE = 0.25  # metres, of the floor's tiles
_COLUMNS = 1000  # of the picture of all markers over time
# Blue and orange, which the colour-blind can tell apart: residuals of 0, and of _WORST metres and more.
_GOOD, _BAD, _WORST = np.array([0.0, 0.35, 0.7]), np.array([0.9, 0.4, 0.0]), 0.02


@dataclass(frozen=True)
class Solved:
    """A recording with what it was solved from.

    Attributes:
        sequence: the recording.
        body: the model.
        v_template: (V, 3) the subject at rest.
        layout: of the M markers.
        observed: (T, M, 3) where they were seen, metres; NaN where missing.
        model: (T, M, 3) where the body has them.
        residuals: (T, M) distances between these; NaN where missing.
    """

    sequence: Sequence
    body: BodyModel
    v_template: torch.Tensor
    layout: Layout
    observed: np.ndarray
    model: np.ndarray
    residuals: np.ndarray


def draw_quality(path: Path, solved: Solved, facts: dict[str, Any], limits: Limits, object_mesh: Mesh | None) -> None:
    """Draw how well a recording fits: `.png`, residuals over time, and where films can be made `.webp`.

    Args:
        path: of both, without suffix.
        solved: the recording.
        facts: of its quality.
        limits: beyond which frames are flagged.
        object_mesh: the object's mesh, to show it.
    """
    _plot(Path(f"{path}.png"), solved, facts, limits)
    if can_render() is None:
        _film(Path(f"{path}.webp"), solved, object_mesh)


def _plot(path: Path, solved: Solved, facts: dict[str, Any], limits: Limits) -> None:
    """Distances by type over time; which marker is off when; and the frames that are flagged, by reason."""
    residuals, layout, rate = solved.residuals, solved.layout, solved.sequence.framerate
    seconds, end = np.arange(len(residuals)) / rate, len(residuals) / rate
    height = max(2.5, 0.09 * len(layout.markers))
    figure = Figure((12, 4.5 + height), layout="constrained")
    curves, each, flags = figure.subplots(3, 1, sharex=True, height_ratios=(3, height, 1))
    for type_, color in TYPE_COLORS.items():
        those = layout.types == type_
        if those.any():
            values = 1e3 * np.where(residuals > limits.outlier, np.nan, residuals)[:, those]
            seen = np.isfinite(values).sum(1)
            mean = np.where(seen > 0, np.nansum(values, 1) / np.maximum(1, seen), np.nan)
            curves.plot(seconds, mean, color=color, label=f"{type_}, {those.sum()} markers", linewidth=0.9)
    curves.axhline(1e3 * limits.residual, color="0.5", linestyle="--", linewidth=0.9, label="flagged above")
    curves.set(ylabel="mean distance\nwithout outliers, mm", ylim=(0, None), xlim=(0, end))
    curves.legend(loc="upper right", fontsize="small")
    curves.set_title(
        f"markers {facts['residual_mm']['median']} mm off (median of those seen), "
        f"{facts['missing']:.1%} missing, {facts['outliers']:.1%} outliers, "
        f"{facts['flagged_frames']} of {facts['frames']} frames flagged",
        fontsize="medium",
    )
    image = each.imshow(
        1e3 * _thinned(residuals).T, aspect="auto", interpolation="nearest", cmap=_missing_white(),
        vmin=0, vmax=1e3 * limits.outlier, extent=(0, end, len(layout.markers) - 0.5, -0.5),
    )  # fmt: skip
    each.set_yticks(range(len(layout.markers)), layout.labels, fontsize=5)
    figure.colorbar(image, ax=each, extend="max", label="distance of each marker, mm (white: missing)")
    reasons = [*facts["flagged"]]
    for row, reason in enumerate(reasons):
        at = np.array(facts["flagged"][reason], float) / rate
        flags.plot(at, np.full(len(at), row), "|", color="black", markersize=9)
    flags.set_yticks(range(len(reasons)), reasons)
    flags.set(ylim=(len(reasons) - 0.5, -0.5), ylabel="flagged", xlabel="time, s")
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=100, metadata={"Software": None})


def _thinned(residuals: np.ndarray) -> np.ndarray:
    """(up to _COLUMNS, M) the largest distance of each marker in stretches of frames; NaN where it is never seen."""
    length = -(-len(residuals) // _COLUMNS)
    padded = np.pad(residuals, ((0, -len(residuals) % length), (0, 0)), constant_values=np.nan)
    return np.fmax.reduce(padded.reshape(-1, length, residuals.shape[1]), 1)


def _missing_white() -> Colormap:
    return colormaps["cividis"].with_extremes(bad="white", over=_BAD)


def _film(path: Path, solved: Solved, object_mesh: Mesh | None) -> None:
    sequence, body, rate = solved.sequence, solved.body, solved.sequence.framerate
    every = max(round(rate / _FRAMES_PER_SECOND), -(-len(sequence) // _MOST_FRAMES))
    frames = np.arange(0, len(sequence), every)
    with torch.no_grad():
        skins = torch.cat([*posed_vertices(sequence.body, body, solved.v_template, frames)]).numpy()
    middle = skins.mean(1)
    reach = np.abs(skins - middle[:, None]).max((0, 1)) + 0.05
    floor = float(skins[..., 2].min())
    pictures = []
    for frame, skin, centre in zip(frames, skins, middle, strict=True):
        seen, at, off = solved.observed[frame], solved.model[frame], solved.residuals[frame]
        shapes = [_tiles(centre, reach, floor), Shape(skin, body.faces.numpy(), SKIN, 0.55)]
        shapes += [_seen(seen, off), *_sticks(seen, at)]
        if object_mesh is not None:
            placed = sequence.object.to_world(torch.tensor(object_mesh.vertices), np.array([frame]))[0]
            shapes.append(Shape(placed.numpy(), object_mesh.faces, OBJECT))
        picture = render(shapes, _VIEW, size=(460, 520))
        pictures.append(Image.fromarray(contact_sheet([picture], [f"{frame / rate:.2f} s  {_in_short(off)}"])))
    with replacing(path) as temporary:
        first, *others = pictures
        duration = round(1000 * every / rate)
        first.save(temporary, save_all=True, append_images=others, duration=duration, loop=0)


def _in_short(residuals: np.ndarray) -> str:
    seen = 1e3 * residuals[np.isfinite(residuals)]
    if not len(seen):
        return "no marker is seen"
    return f"{len(seen)} of {len(residuals)} markers, {seen.mean():.1f} mm off, worst {seen.max():.0f} mm"


def _tiles(middle: np.ndarray, reach: np.ndarray, height: float) -> Shape:
    """A floor that stays where it is, as far as `reach` (3) about the body's middle (3).

    Two further corners, of no face, frame all pictures alike.
    """
    low, high = (np.ceil((middle[:2] + side * reach[:2]) / _TILE).astype(int) for side in (-1, 1))
    cells = np.array([(x, y) for x in range(low[0], high[0]) for y in range(low[1], high[1])])
    corners = (cells[:, None] + [[0, 0], [1, 0], [1, 1], [0, 1]]) * _TILE
    corners = np.concatenate([corners, np.full((*corners.shape[:2], 1), height)], -1).reshape(-1, 3)
    faces = (4 * np.arange(len(cells))[:, None, None] + [[0, 1, 2], [0, 2, 3]]).reshape(-1, 3)
    shade = np.repeat(np.where(cells.sum(1) % 2, 0.8, 0.92), 4)
    shade = np.concatenate([shade, [0.9, 0.9]])[:, None] * [1, 1, 1]
    frame = np.stack([middle - reach, middle + reach])
    return Shape(np.concatenate([corners, frame]), faces, shade)


def _seen(places: np.ndarray, residuals: np.ndarray) -> Shape:
    """Balls at the markers that are seen, from blue to orange by their residuals."""
    seen = np.isfinite(residuals).nonzero()[0]
    bad = np.clip(residuals[seen] / _WORST, 0, 1)[:, None]
    return balls(places[seen], np.full(len(seen), 0.01), (1 - bad) * _GOOD + bad * _BAD)


def _sticks(observed: np.ndarray, model: np.ndarray) -> list[Shape]:
    """Lines from markers to where the body has them, where these are far enough apart to be seen."""
    far = (np.linalg.norm(observed - model, axis=-1) > 0.005).nonzero()[0]
    sticks = [trimesh.creation.cylinder(0.003, segment=[observed[k], model[k]], sections=6) for k in far]
    if not sticks:
        return []
    whole = trimesh.util.concatenate(sticks)
    return [Shape(whole.vertices, whole.faces, _BAD)]
