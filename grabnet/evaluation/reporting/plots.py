"""The report's plots, as SVG."""

from __future__ import annotations

import io
from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure as Canvas

from grabnet.evaluation.methods import Method
from grabnet.evaluation.metrics import Metric
from grabnet.evaluation.summary import Figure, find

# Ground truth, baseline, networks, then what else there is.
COLOURS = ("#3f7d58", "#98a2ad", "#e3a64b", "#c5523f", "#4b6a9b", "#8a5a9e", "#3b8f9c", "#7a6a53")
_INK, _FAINT = "#28323c", "#d9dee3"
_PLAIN = {"text.parse_math": False}  # names are no formulas
_SIZE = 8.5  # points, of the text


@mpl.rc_context(_PLAIN)
def intervals(numbers: Sequence[Figure], methods: Sequence[Method], metrics: Sequence[Metric]) -> str:
    """Draw each metric's value and interval by row, side by side."""
    columns = min(4, len(metrics))
    lines = -(-len(metrics) // columns)
    canvas, axes = _canvas(lines, columns, height=0.55 + 0.24 * len(methods))
    for axis, metric in zip(axes, metrics, strict=False):
        for k, method in enumerate(methods):
            if (estimate := find(numbers, metric, method.name)) is not None:
                low, high = estimate.interval
                axis.plot([low, high], [k, k], color=COLOURS[k % len(COLOURS)], linewidth=2.4, solid_capstyle="round")
                axis.plot(estimate.value, k, "o", color=COLOURS[k % len(COLOURS)], markersize=5.5)
        first = axis.get_subplotspec().is_first_col()
        axis.set_yticks(range(len(methods)), [method.name for method in methods] if first else [""] * len(methods))
        axis.set_ylim(len(methods) - 0.5, -0.5)
        arrow = {"lower": " ←", "higher": " →"}.get(metric.better or "", "")
        _entitle(axis, f"{metric.label}{arrow}")
        axis.grid(axis="y", visible=False)
    return _svg(canvas, axes[len(metrics) :])


@mpl.rc_context(_PLAIN)
def distributions(methods: Sequence[Method], metrics: Sequence[Metric], objects: Sequence[str]) -> str:
    """Draw the share of all grasps at or below each value."""
    canvas, axes = _canvas(1, len(metrics), height=2.3)
    for axis, metric in zip(axes, metrics, strict=True):
        highest = 0.0
        for k, method in enumerate(methods):
            values = np.concatenate([method.values(metric, name) for name in objects])
            values = np.sort(values[np.isfinite(values)])
            if len(values):
                share = 100 * np.arange(1, len(values) + 1) / len(values)
                axis.step(
                    values, share, where="post", color=COLOURS[k % len(COLOURS)], linewidth=1.8, label=method.name
                )
                highest = max(highest, float(np.quantile(values, 0.98)))
        axis.set_xlim(0, highest or 1)
        axis.set_ylim(0, 100)
        _entitle(axis, metric.label)
        if axis.get_subplotspec().is_first_col():
            axis.set_ylabel("% of grasps at or below")
    _legend(canvas, axes[0])
    return _svg(canvas)


def parts(numbers: Sequence[Figure], methods: Sequence[Method], metrics: Sequence[Metric]) -> str:
    """Draw metrics of parts: bars side by side, a diagram for each series."""
    series = {metric.series: [m for m in metrics if m.series == metric.series] for metric in metrics}
    canvas, axes = _canvas(1, len(series), height=2.5)
    width = 0.8 / len(methods)
    for axis, (title, of_parts) in zip(axes, series.items(), strict=True):
        for k, method in enumerate(methods):
            for p, metric in enumerate(of_parts):
                estimate = find(numbers, metric, method.name)
                if estimate is not None:
                    place = p + (k - (len(methods) - 1) / 2) * width
                    label = method.name if p == 0 else None
                    axis.bar(place, estimate.value, 0.92 * width, color=COLOURS[k % len(COLOURS)], label=label)
                    axis.plot([place, place], estimate.interval, color=_INK, linewidth=0.8)
        axis.set_xticks(range(len(of_parts)), [metric.part for metric in of_parts])
        axis.grid(axis="x", visible=False)
        _entitle(axis, f"{title}_… [{of_parts[0].unit}]" if of_parts[0].unit else f"{title}_…")
    _legend(canvas, axes[0])
    return _svg(canvas)


def _canvas(lines: int, columns: int, height: float) -> tuple[Canvas, list[Axes]]:
    style = {
        "font.size": _SIZE,
        "axes.edgecolor": _FAINT,
        "axes.labelcolor": _INK,
        "xtick.color": _INK,
        "ytick.color": _INK,
        "xtick.major.size": 0,
        "ytick.major.size": 0,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "grid.color": "#edf0f2",
    }
    with mpl.rc_context(style):
        canvas = Canvas(figsize=(11, lines * height + 0.35), layout="constrained")
        FigureCanvasSVG(canvas)
        axes = canvas.subplots(lines, columns, squeeze=False).ravel().tolist()
    return canvas, axes


def _entitle(axis: Axes, title: str) -> None:
    axis.set_title(title, loc="left", fontsize=_SIZE, color=_INK)


def _legend(canvas: Canvas, axis: Axes) -> None:
    handles, labels = axis.get_legend_handles_labels()
    canvas.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False, fontsize=_SIZE)


def _svg(canvas: Canvas, unused: Sequence[Axes] = ()) -> str:
    for axis in unused:
        axis.remove()
    text = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "grabnet"}):  # the same names in every file
        canvas.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()
