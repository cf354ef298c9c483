"""The figures as files: JSON, CSV and LaTeX."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from typing import Any

from grabnet.cli.numbers import digits
from grabnet.evaluation.metrics import ALL, Metric
from grabnet.evaluation.reporting.findings import Findings
from grabnet.evaluation.summary import find
from grabnet.io.files import replacing, write_json


def write_json_tables(path: Path, findings: Findings) -> None:
    """Write `metrics.json`.

    It holds each metric's protocol, unit, definition and values by row and object, with bounds of the 95 % interval and
    the number of grasps; scores of networks, by protocol; rows in the wrong order; failures; what all was made with.
    """
    metrics: dict[str, Any] = {}
    for figure in findings.figures:
        metric = figure.metric
        about = {"protocol": metric.protocol, "unit": metric.unit, "definition": metric.about, "better": metric.better}
        entry = metrics.setdefault(metric.title, about | {"samples": metric.samples, "values": {}})
        low, high = figure.estimate.interval
        cell = {"value": figure.estimate.value, "low": low, "high": high, "n": figure.estimate.n}
        entry["values"].setdefault(figure.method, {})[figure.object] = cell
    write_json(
        path,
        {
            "split": findings.split,
            "rows": {method.name: method.about for method in findings.methods},
            "metrics": metrics,
            **{protocol: [_flat(asdict(s)) for s in scores] for protocol, scores in findings.scores.items()},
            "unexpected_order": findings.unexpected_order,
            "failures": findings.failures,
            **findings.record,
        },
    )


def write_csv(path: Path, findings: Findings) -> None:
    """Write `metrics.csv`: a line per metric, row and object; of networks a line per metric, network, split, object."""
    lines = []
    for f in findings.figures:
        about = [f.metric.protocol, f.metric.name, f.metric.unit, f.method, findings.split, f.object]
        lines.append([*about, f.estimate.value, *f.estimate.interval, f.estimate.n])
    for protocol, metrics in _by_protocol(findings.scored):
        for s in findings.scores[protocol]:
            for m in metrics:
                lines.append([protocol, m.name, m.unit, s.network, s.split, s.object, s.values[m.name], "", "", s.n])
    header = ["protocol", "metric", "unit", "row", "split", "object", "value", "low", "high", "n"]
    _write_csv(path, [header, *lines])


def write_grasps_csv(path: Path, findings: Findings) -> None:
    """Write `grasps.csv`: a line per grasp with all that is measured of each by itself; empty where it could not be."""
    metrics = [m for m in findings.metrics if m.per_grasp]
    lines = [["row", "object", "grasp", *(f"{m.title} ({m.unit})" if m.unit else m.title for m in metrics)]]
    for method in findings.methods:
        for name, hands in method.hands.items():
            results = method.results[name]
            columns = [results.get(m.title, ()) for m in metrics]
            for i in range(len(hands)):
                cells = [c[i] * m.scale if i < len(c) else math.nan for c, m in zip(columns, metrics, strict=True)]
                lines.append([method.name, name, i, *("" if math.isnan(c) else float(c) for c in cells)])
    _write_csv(path, lines)


def write_latex(path: Path, findings: Findings) -> None:
    """Write `tables.tex`: rows of the first table, of each protocol's by object, and of networks, without the tabular
    around them; definitions in comments."""
    lines = ["% Means over objects; 95 % bootstrap interval over grasps in brackets.", *_headline_rows(findings)]
    for protocol, metrics in _by_protocol(findings.by_object):
        lines += ["", f"% {protocol}, by object: {_defined(metrics)}", *_object_rows(findings, metrics)]
    for protocol, metrics in _by_protocol(findings.scored):
        lines += ["", f"% {protocol}, mean over a split: {_defined(metrics)}"]
        lines.append(_latex_row(["network", "split", *(_latex(m.name) for m in metrics)]))
        for score in findings.scores[protocol]:
            if score.object == ALL:
                values = (digits(score.values[m.name]) for m in metrics)
                lines.append(_latex_row([_latex(score.network), score.split, *values]))
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _headline_rows(findings: Findings) -> list[str]:
    metrics = findings.headlines
    lines = [f"% {m.label}: {m.about}" for m in metrics]
    lines.append(_latex_row(["", *(_latex(m.label) for m in metrics)]))
    for method in findings.methods:
        cells = []
        for metric in metrics:
            estimate = find(findings.figures, metric, method.name)
            if estimate is None:
                cells.append("--")
                continue
            low, high = estimate.interval
            cells.append(f"{digits(estimate.value)} {{\\scriptsize [{digits(low)}, {digits(high)}]}}")
        lines.append(_latex_row([_latex(method.name), *cells]))
    return lines


def _object_rows(findings: Findings, metrics: Sequence[Metric]) -> list[str]:
    columns = [(method, metric) for method in findings.methods for metric in metrics]
    names = (f"{method.name}, {metric.label.partition('/')[2]}" for method, metric in columns)
    lines = [_latex_row(["object", *map(_latex, names)])]
    for name in [*findings.objects, ALL]:
        cells = (find(findings.figures, metric, method.name, name) for method, metric in columns)
        lines.append(_latex_row([_latex(name), *("--" if e is None else digits(e.value) for e in cells)]))
    return lines


def _defined(metrics: Iterable[Metric]) -> str:
    return "; ".join(f"{m.label}: {m.about}" for m in metrics)


def _by_protocol(metrics: Iterable[Metric]) -> list[tuple[str, list[Metric]]]:
    """Return each protocol's metrics: neighbours in the order of the tables."""
    return [(protocol, list(group)) for protocol, group in groupby(metrics, key=lambda metric: metric.protocol)]


def _flat(score: dict[str, Any]) -> dict[str, Any]:
    n, values = score.pop("n"), score.pop("values")
    return {**score, **values, "n": n}


def _latex_row(cells: Iterable[str]) -> str:
    return " & ".join(cells) + r" \\"


def _latex(text: str) -> str:
    special = {"\\": r"\textbackslash{}", "³": "$^3$", "²": "$^2$", "°": r"$^\circ$"}
    special |= {c: "\\" + c for c in "&%$#_{}"}
    return "".join(special.get(c, c) for c in text)


def _write_csv(path: Path, lines: Iterable[Sequence[Any]]) -> None:
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(lines)
