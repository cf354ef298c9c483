"""The figures as files: JSON, CSV and LaTeX."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from grabnet.evaluation.metrics import Metric
from grabnet.evaluation.summary import ALL, find
from grabnet.io.files import replacing, write_json

if TYPE_CHECKING:
    from grabnet.evaluation.reporting.page import Findings

# What a paper's table of grasps shows, where it was measured.
HEADLINES = (
    "table2/vertices",
    "table2/contact",
    "halo/volume",
    "halo/depth",
    "halo/contact",
    "grasptta/volume",
    "grasptta/displacement",
    "shake/success",
    "penetration/max",
    "contact/fingers",
    "contact/pinched",
    "diversity/entropy",
    "diversity/cluster_size",
    "coverage/reached",
)


def headlines(metrics: Sequence[Metric]) -> list[Metric]:
    """Those of the metrics that the first table shows."""
    return [m for title in HEADLINES for m in metrics if m.title == title]


def digits(value: float) -> str:
    """A number with three digits that count, and not more than three after the point."""
    if not math.isfinite(value):
        return "–"
    size = abs(value)
    if size < 0.0005:
        return "0"
    return f"{value:.{0 if size >= 99.95 else 1 if size >= 9.995 else 2 if size >= 0.0995 else 3}f}"


def write_json_tables(path: Path, findings: Findings) -> None:
    """`metrics.json`: each metric's protocol, unit, definition and values by row and object, with bounds of the 95 %
    interval and the number of grasps; reconstruction; rows in the wrong order; failures; what all was made with."""
    metrics: dict[str, Any] = {}
    for figure in findings.figures:
        metric = figure.metric
        about = {"protocol": metric.protocol, "unit": metric.unit, "definition": metric.about, "better": metric.better}
        entry = metrics.setdefault(metric.title, about | {"samples": metric.samples, "values": {}})
        low, high = figure.estimate.interval
        cell = {"value": figure.estimate.value, "low": low, "high": high, "n": figure.estimate.n}
        entry["values"].setdefault(figure.row, {})[figure.object] = cell
    write_json(
        path,
        {
            "split": findings.split,
            "rows": {row.name: row.about for row in findings.rows},
            "metrics": metrics,
            "reconstruction": [error._asdict() for error in findings.errors],
            "unexpected_order": findings.surprises,
            "failed_simulations": findings.failures,
            **findings.record,
        },
    )


def write_csv(path: Path, findings: Findings) -> None:
    """`metrics.csv`: a line per metric, row and object; reconstruction errors as those of the networks."""
    lines = []
    for f in findings.figures:
        about = [f.metric.protocol, f.metric.name, f.metric.unit, f.row, findings.split, f.object]
        lines.append([*about, f.estimate.value, *f.estimate.interval, f.estimate.n])
    for e in findings.errors:
        for name in ("v2v", "v2v_mae"):
            lines.append(["reconstruction", name, "mm", e.network, e.split, e.object, getattr(e, name), "", "", e.n])
    header = ["protocol", "metric", "unit", "row", "split", "object", "value", "low", "high", "n"]
    _write_csv(path, [header, *lines])


def write_grasps_csv(path: Path, findings: Findings) -> None:
    """`grasps.csv`: a line per grasp with all that is measured of each by itself; empty where it could not be."""
    metrics = [m for m in findings.metrics if m.protocol not in ("diversity", "coverage")]
    lines = [["row", "object", "grasp", *(f"{m.title} ({m.unit})" if m.unit else m.title for m in metrics)]]
    for row in findings.rows:
        for thing, hands in row.hands.items():
            found = row.results[thing]
            columns = [found.get(m.protocol, {}).get(m.name, ()) for m in metrics]
            for i in range(len(hands)):
                cells = [c[i] * m.scale if i < len(c) else math.nan for c, m in zip(columns, metrics, strict=True)]
                lines.append([row.name, thing, i, *("" if math.isnan(c) else float(c) for c in cells)])
    _write_csv(path, lines)


def write_latex(path: Path, findings: Findings) -> None:
    """`tables.tex`: rows of the summary table and of Table 2, without the tabular around them; protocols in comments
    and headings."""
    chosen = headlines(findings.metrics)
    lines = ["% Means over objects; 95 % bootstrap interval over grasps in brackets."]
    lines += [f"% {m.title} [{m.unit}]: {m.about}" for m in chosen]
    lines.append(_latex_row(["", *(_latex(f"{m.title}" + (f" [{m.unit}]" if m.unit else "")) for m in chosen)]))
    for row in findings.rows:
        cells = []
        for metric in chosen:
            estimate = find(findings.figures, metric, row.name)
            if estimate is None:
                cells.append("--")
                continue
            low, high = estimate.interval
            cells.append(f"{digits(estimate.value)} {{\\scriptsize [{digits(low)}, {digits(high)}]}}")
        lines.append(_latex_row([_latex(row.name), *cells]))
    table2 = [m for m in findings.metrics if m.protocol == "table2"]
    lines += ["", "% Table 2: " + "; ".join(f"{m.title} [{m.unit}]: {m.about}" for m in table2)]
    names = [f"{row.name}, {m.name} [{m.unit}]" for row in findings.rows for m in table2]
    lines.append(_latex_row(["object", *map(_latex, names)]))
    for thing in [*findings.objects, ALL]:
        found = [find(findings.figures, m, row.name, thing) for row in findings.rows for m in table2]
        lines.append(_latex_row([_latex(thing), *("--" if e is None else digits(e.value) for e in found)]))
    if findings.errors:
        lines += ["", "% reconstruction: mean over a split, mm", _latex_row(["network", "split", "v2v", r"v2v\_mae"])]
        for e in findings.errors:
            if e.object == ALL:
                lines.append(_latex_row([e.network, e.split, digits(e.v2v), digits(e.v2v_mae)]))
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _latex_row(cells: Iterable[str]) -> str:
    return " & ".join(cells) + r" \\"


def _latex(text: str) -> str:
    special = {"\\": r"\textbackslash{}", "³": "$^3$", "²": "$^2$", "°": r"$^\circ$"}
    special |= {c: "\\" + c for c in "&%$#_{}"}
    return "".join(special.get(c, c) for c in text)


def _write_csv(path: Path, lines: Iterable[Sequence[Any]]) -> None:
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(lines)
