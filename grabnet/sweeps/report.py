"""How the runs of a sweep ended: a table on the screen, the same as sweep.csv, and a picture, sweep.png."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from rich.console import Console
from rich.table import Table

from grabnet.io.files import replacing
from grabnet.sweeps.runs import DONE, FAILED, PRUNED, UNFINISHED, Run
from grabnet.training.history import best_epoch, read_history

COLOURS = {DONE: "tab:blue", PRUNED: "tab:orange", FAILED: "tab:red", UNFINISHED: "tab:gray"}

Row = dict[str, str | float | None]


@mpl.rc_context({"text.parse_math": False})  # names are no formulas
def report(runs: Sequence[Run], objective: str, folder: Path) -> None:
    """Print the table and write both files into the sweep's folder."""
    keys = _keys(runs)
    rows = [dict.fromkeys(keys) | row(run, objective) for run in runs]
    Console().print(_table(rows, runs))
    with replacing(folder / "sweep.csv") as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    figure = plot(runs, objective)
    with replacing(folder / "sweep.png") as temporary:
        figure.savefig(temporary)


def _keys(runs: Sequence[Run]) -> list[str]:
    """Of the values that any run has: a search that was started again may have widened or narrowed its space."""
    return list(dict.fromkeys(key for run in runs for key in run.values))


def row(run: Run, objective: str) -> Row:
    """One line of the table: the swept values, the status, and the objective and v2v (mm) of the best epoch."""
    epochs = read_history(run.folder)
    best = _best(run, objective) or {}
    return {
        **run.values,
        "status": run.status,
        **{name: best.get(name) for name in dict.fromkeys((objective, "val/v2v"))},
        "epochs": len(epochs),
        "seconds": epochs[-1].get("seconds") if epochs else None,
        "folder": run.folder.name,
        "reason": run.reason,
    }


def _best(run: Run, objective: str) -> dict[str, float] | None:
    """What was measured at the best epoch, or in all, by a run without epochs; None where nothing was."""
    if epochs := read_history(run.folder):
        return best_epoch(epochs, objective)
    return run.metrics() if run.status == DONE else None


def _table(rows: Sequence[Row], runs: Sequence[Run]) -> Table:
    """All columns but the reasons, which are too long and were printed when they happened."""
    table = Table(title=f"{len(runs)} runs in {runs[0].folder.parent}")
    names = [name for name in rows[0] if name not in ("folder", "reason")]
    for name in names:
        table.add_column(name.replace(".", ".\n"), justify="left" if name == "status" else "right", overflow="fold")
    for line in rows:
        table.add_row(*(_cell(line[name]) for name in names), style="red" if line["status"] == FAILED else None)
    return table


def _cell(value: str | float | None) -> str:
    try:
        return "" if value is None else f"{float(value):.5g}"
    except ValueError:
        return str(value)


def plot(runs: Sequence[Run], objective: str) -> Figure:
    """The objective by epoch, and at its best against each swept value."""
    keys = [key for key in _keys(runs) if len({run.values.get(key) for run in runs}) > 1]
    columns = min(3, 1 + len(keys))
    lines = -(-(1 + len(keys)) // columns)
    figure = Figure(figsize=(5 * columns, 3.6 * lines), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(lines, columns, squeeze=False).flat
    _curves(next(panels), runs, objective)
    for key in keys:
        _scatter(next(panels), [run for run in runs if key in run.values], key, objective)
    for panel in panels:
        panel.set_axis_off()
    return figure


def _curves(panel: Axes, runs: Sequence[Run], objective: str) -> None:
    for status, colour in COLOURS.items():
        those = [run for run in runs if run.status == status]
        if not those:
            continue
        panel.plot([], [], color=colour, label=f"{len(those)} {status}")
        for run in those:
            epochs = [epoch for epoch in read_history(run.folder) if {objective, "epoch"} <= epoch.keys()]
            panel.plot([e["epoch"] + 1 for e in epochs], [e[objective] for e in epochs], ".-", color=colour, alpha=0.6)
    panel.set(xlabel="epoch", ylabel=objective, yscale=_scale(panel.dataLim.intervaly))
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    panel.legend(frameon=False)


def _scatter(panel: Axes, runs: Sequence[Run], key: str, objective: str) -> None:
    """Numbers at their place, other values at equal distances."""
    values = [run.values[key] for run in runs]
    try:
        places = [float(value) for value in values]
        panel.set_xscale(_scale(places))
    except ValueError:
        names = list(dict.fromkeys(values))
        places = [float(names.index(value)) for value in values]
        panel.set_xticks(range(len(names)), names)
    for run, place in zip(runs, places, strict=True):
        if best := _best(run, objective):
            panel.plot(place, best[objective], "o", color=COLOURS[run.status], alpha=0.8)
        else:  # nothing measured: a cross at the foot
            panel.plot(place, 0.02, "x", color=COLOURS[run.status], transform=panel.get_xaxis_transform())
    panel.set(xlabel=key, ylabel=f"best {objective}", yscale=_scale(panel.dataLim.intervaly))


def _scale(values: Sequence[float]) -> str:
    """Logarithmic where positive numbers span more than a decade."""
    return "log" if min(values) > 0 and max(values) > 10 * min(values) else "linear"
