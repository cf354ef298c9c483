"""Plots of a study's report, as SVG."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from grabnet.evaluation.bootstrap import Estimate
from grabnet.study.filtering import Judged
from grabnet.study.key import ALL
from grabnet.study.scores import Score

COLOURS = ("#3f7d58", "#c5523f", "#e3a64b", "#4b6a9b", "#8a5a9e", "#3b8f9c", "#7a6a53")
# From worst to best answer; pale enough to write on.
_SCALE = mpl.colors.LinearSegmentedColormap.from_list(
    "answers", ("#d9776a", "#f1cdb4", "#eeeeea", "#bfdcc4", "#74b189")
)
_STYLE = {
    "font.size": 8.5,
    "axes.edgecolor": "#d9dee3",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#edf0f2",
    "text.parse_math": False,  # names may have $
    "svg.hashsalt": "grabnet",  # the same names in every file
}


def means(scores: Sequence[Score], conditions: Sequence[str], objects: Sequence[str], levels: int) -> str:
    """Draw mean and interval by object and condition."""
    with mpl.rc_context(_STYLE):
        figure, (axis,) = _figure(1, 2.9)
        names = [*objects, ALL]
        for k, condition in enumerate(conditions):
            shift = (k - (len(conditions) - 1) / 2) * 0.18
            for o, name in enumerate(names):
                score = next(s for s in scores if (s.condition, s.object) == (condition, name))
                if score.mean.n:
                    colour, label = COLOURS[k % len(COLOURS)], condition if o == 0 else None
                    axis.plot([o + shift] * 2, score.mean.interval, color=colour, linewidth=2.2)
                    axis.plot(o + shift, score.mean.value, "o", color=colour, markersize=5, label=label)
        axis.set_xticks(range(len(names)), names)
        axis.set_ylim(1, levels)
        axis.set_ylabel("mean answer")
        axis.legend(frameon=False, loc="lower left", ncols=len(conditions))
        return _svg(figure)


def shares(of_answers: Mapping[str, np.ndarray], levels: Sequence[str]) -> str:
    """Draw how often each answer was given, by condition."""
    with mpl.rc_context(_STYLE):
        figure, (axis,) = _figure(1, 0.9 + 0.36 * len(of_answers))
        for k, level in enumerate(levels):
            start = [share[:k].sum() for share in of_answers.values()]
            width = [share[k] for share in of_answers.values()]
            axis.barh(range(len(of_answers)), width, left=start, color=_SCALE(k / (len(levels) - 1)), label=level)
            for row, (left, share) in enumerate(zip(start, width, strict=True)):
                if share > 0.03:
                    axis.text(left + share / 2, row, f"{100 * share:.0f} %", ha="center", va="center")
        axis.set_yticks(range(len(of_answers)), list(of_answers))
        axis.set_ylim(len(of_answers) - 0.5, -0.5)
        axis.set_xlim(0, 1)
        axis.set_xticks([])
        axis.grid(visible=False)
        figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=len(levels), frameon=False)
        return _svg(figure)


def raters(judged: Sequence[Judged], share: float) -> str:
    """Draw how many catch trials raters took for plausible."""
    with mpl.rc_context(_STYLE):
        figure, (axis,) = _figure(1, 2.1)
        missed = [
            np.array([j.missed / j.catches for j in judged if j.catches and j.is_kept == kept]) for kept in (1, 0)
        ]
        axis.hist(missed, np.linspace(0, 1, 21), stacked=True, color=COLOURS[:2], label=["count", "left out"])
        axis.axvline(share, color="#28323c", linewidth=1, linestyle="--")
        axis.set_xlabel("share of catch trials taken for plausible")
        axis.set_ylabel("raters")
        axis.legend(frameon=False)
        return _svg(figure)


def strengths(of_conditions: Mapping[str, Estimate], label: str) -> str:
    """Draw values with intervals against the first, at 0."""
    with mpl.rc_context(_STYLE):
        figure, (axis,) = _figure(1, 0.8 + 0.3 * len(of_conditions))
        for k, estimate in enumerate(of_conditions.values()):
            axis.plot(estimate.interval, [k, k], color=COLOURS[k % len(COLOURS)], linewidth=2.4)
            axis.plot(estimate.value, k, "o", color=COLOURS[k % len(COLOURS)], markersize=5.5)
        axis.axvline(0, color="#98a2ad", linewidth=1)
        axis.set_yticks(range(len(of_conditions)), list(of_conditions))
        axis.set_ylim(len(of_conditions) - 0.5, -0.5)
        axis.set_xlabel(label)
        return _svg(figure)


def _figure(columns: int, height: float) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(9, height), layout="constrained")
    FigureCanvasSVG(figure)
    return figure, figure.subplots(1, columns, squeeze=False).ravel().tolist()


def _svg(figure: Figure) -> str:
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()
