"""What the figures share: a plain style, bars side by side, tiles of pictures with one scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

COLOURS = ("#4f7cac", "#c8553d", "#3f7d58", "#e3a64b")
STYLE = {
    "text.parse_math": False,  # names are no formulas
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid.axis": "y",
    "axes.grid": True,
    "grid.color": "#edf0f2",
    "pdf.fonttype": 42,
}


@mpl.rc_context(STYLE)
def panels(rows: int, columns: int, width: float, height: float) -> tuple[Figure, np.ndarray]:
    """A figure of (rows, columns) axes of a size each, inches."""
    figure = Figure((columns * width, rows * height + 0.4), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def bars(axes: Axes, names: Sequence[str], series: Mapping[str, Sequence[float]], unit: str) -> None:
    """Bars of several series side by side, their values above them; NaN has no bar."""
    width = 0.8 / max(len(series), 1)
    for k, (label, values) in enumerate(series.items()):
        places = np.arange(len(names)) + (k - (len(series) - 1) / 2) * width
        drawn = axes.bar(places, np.nan_to_num(values), 0.92 * width, color=COLOURS[k % len(COLOURS)], label=label)
        if len(names) * len(series) <= 40:
            axes.bar_label(drawn, ["" if np.isnan(v) else f"{v:,.0f}" for v in values], fontsize=7, padding=1)
    axes.set_xticks(range(len(names)), names, rotation=0 if len(names) < 12 else 90, ha="center", fontsize=8)
    axes.set_ylabel(unit)


def legend(figure: Figure, axes: Axes) -> None:
    """The names of an axes' series, below the figure."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)


def heat_colours(share: np.ndarray, highest: float) -> np.ndarray:
    """(V,) shares → (V, 3) colours in [0, 1], from blue where nothing touches to red at `highest`."""
    return colormaps["turbo"](0.08 + 0.84 * np.clip(share / max(highest, 1e-12), 0, 1))[:, :3]


def difference_colours(change: np.ndarray, highest: float) -> np.ndarray:
    """(V,) differences of shares → (V, 3) colours: blue at -`highest`, white at 0, red at `highest`."""
    return colormaps["RdBu_r"](0.5 + 0.45 * np.clip(change / max(highest, 1e-12), -1, 1))[:, :3]


@mpl.rc_context(STYLE)
def tiled(
    tiles: Sequence[Sequence[np.ndarray | None]],
    lines: Sequence[str],
    heads: Sequence[str],
    scales: Sequence[tuple[str, str, float, float]] = (),
    captions: Sequence[Sequence[str]] = (),
    size: float = 1.6,
) -> Figure:
    """Pictures in a grid.

    Args:
        tiles: uint8 (H, W, 3) by line and column; None where there is none.
        lines: name of each line.
        heads: name of each column.
        scales: colour scales below: title with unit, "heat" or "difference", lowest and highest value.
        captions: below each tile; none when empty.
        size: width of a tile, inches.
    """
    height, width = next(tile for line in tiles for tile in line if tile is not None).shape[:2]
    pitch = height + (round(0.2 * height) if captions else 0)
    inches = len(heads) * size, len(lines) * size * pitch / width
    beside = 0.4 + 0.095 * max(len(part) for line in lines for part in line.split("\n"))
    figure = Figure((inches[0] + beside, inches[1] + 0.5 + 0.75 * bool(scales)), layout="constrained")
    parts = figure.subfigures(
        1 + bool(scales), 1, height_ratios=[inches[1] + 0.5, 0.75][: 1 + bool(scales)], squeeze=False
    )
    axes = parts[0, 0].subplots()
    for row, column in np.ndindex(len(lines), len(heads)):
        tile, left, top = tiles[row][column], column * width, row * pitch
        centre = left + width / 2
        if tile is not None:  # each by itself: of one large picture Matplotlib makes many copies
            axes.imshow(tile, extent=(left, left + width, top + height, top))
        elif not captions:
            axes.text(centre, top + height / 2, "none", ha="center", va="center", color="#98a2ad", fontsize=8)
        if captions:
            axes.text(centre, top + height, captions[row][column], ha="center", va="top", fontsize=7)
    axes.set(xlim=(0, len(heads) * width), ylim=(len(lines) * pitch, 0), aspect="equal")
    axes.set_xticks((np.arange(len(heads)) + 0.5) * width, heads)
    axes.set_yticks(np.arange(len(lines)) * pitch + height / 2, lines)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.grid(False)
    if scales:
        below = parts[1, 0].subplots(1, len(scales), squeeze=False)[0]
        for here, (title, kind, low, high) in zip(below, scales, strict=True):
            _scale(here, title, kind, low, high)
            here.set_box_aspect(0.15 * len(scales) / figure.get_figwidth())
    return figure


def _scale(axes: Axes, title: str, kind: str, low: float, high: float) -> None:
    values = np.linspace(low, high, 256)
    colours = heat_colours(values, high) if kind == "heat" else difference_colours(values, high)
    cmap = mpl.colors.ListedColormap(colours)
    bar = axes.figure.colorbar(ScalarMappable(Normalize(low, high), cmap), cax=axes, orientation="horizontal")
    bar.set_label(title, fontsize=8)
    axes.tick_params(labelsize=8)
