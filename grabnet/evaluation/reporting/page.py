"""The report: one HTML page with all tables, plots and pictures in it, which fetches nothing from anywhere."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from grabnet.data.datamodule import SPLITS
from grabnet.evaluation.cache import Cache
from grabnet.evaluation.metrics import Metric
from grabnet.evaluation.protocols.contact import PARTS
from grabnet.evaluation.protocols.reconstruction import Errors
from grabnet.evaluation.reporting import published as reported
from grabnet.evaluation.reporting.plots import COLOURS, distributions, fingers, intervals
from grabnet.evaluation.reporting.tables import digits, headlines
from grabnet.evaluation.reporting.views import grasp_view, heat_view
from grabnet.evaluation.summary import ALL, Figure, Row, find
from grabnet.geometry.mesh import Mesh
from grabnet.io.files import replacing
from grabnet.visual.pictures import can_render

_TEMPLATE = Path(__file__).with_name("page.html")
_ARROWS = {"lower": "↓", "higher": "↑", None: ""}


@dataclass(frozen=True, eq=False, kw_only=True)
class Findings:
    """All that an evaluation found.

    Attributes:
        rows: methods, in the order of the tables. objects: meshes by name. metrics: in order.
        figures: numbers of the tables. errors: of reconstruction.
        surprises: sentences on rows that come out in the wrong order. failures: on simulations that failed.
        split: of the objects.
        record: what all was made with, ready for JSON.
    """

    rows: Sequence[Row]
    objects: dict[str, Mesh]
    metrics: Sequence[Metric]
    figures: Sequence[Figure]
    errors: Sequence[Errors]
    surprises: Sequence[str]
    failures: Sequence[str]
    split: str
    record: dict[str, Any]

    def of(self, *protocols: str) -> list[Metric]:
        """Metrics of these protocols of which anything was measured."""
        there = {f.metric for f in self.figures}
        return [m for m in self.metrics if m.protocol in protocols and m in there]


def write_report(path: Path, findings: Findings, pictures: int, cache: Cache) -> None:
    """Write the page, atomically.

    Args:
        pictures: grasps drawn per object and row; none where this machine cannot draw.
        cache: of pictures.
    """
    reason = can_render() if pictures else "No pictures were asked for."
    sections = [
        ("At a glance", _glance(findings)),
        ("Grasps", f"<p class=note>{escape(reason)}</p>" if reason else _pictures(findings, pictures, cache)),
        ("Reconstruction", _reconstruction(findings)),
        ("Closest ground truth", _table2(findings)),
        ("Protocols of the field", _field(findings)),
        ("Contact", _contact(findings)),
        ("Posture, novelty, coverage", _plain_table(findings, findings.of("posture", "novelty", "coverage"))),
        ("Distributions", _distributions(findings)),
        ("Definitions", _definitions(findings)),
        ("Made with", f"<pre>{escape(json.dumps(findings.record, indent=2))}</pre>"),
    ]
    sections = [(title, body) for title, body in sections if body]
    contents = "".join(f'<a href="#s{k}">{escape(title)}</a>' for k, (title, _) in enumerate(sections))
    main = "".join(f'<section id="s{k}"><h2>{escape(t)}</h2>{body}</section>' for k, (t, body) in enumerate(sections))
    page = _TEMPLATE.read_text(encoding="utf-8")
    parts = {"SUBTITLE": escape(_subtitle(findings)), "CONTENTS": contents, "MAIN": main}
    for name, text in parts.items():
        page = page.replace(f"<!--{name}-->", text)
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _subtitle(findings: Findings) -> str:
    grasps = sum(len(hands) for row in findings.rows for hands in row.hands.values())
    things = len(findings.objects)
    return (
        f"{grasps:,} grasps of {things} {findings.split} object{'s' * (things != 1)} by {len(findings.rows)} rows; "
        f"made {findings.record['provenance']['made'][:10]}"
    )


def _glance(findings: Findings) -> str:
    chosen = [m for m in headlines(findings.metrics) if any(f.metric == m for f in findings.figures)]
    rows = "".join(
        f"<dt>{_dot(k)}{escape(row.name)}</dt><dd>{escape(row.about)}</dd>" for k, row in enumerate(findings.rows)
    )
    if findings.surprises:
        order = (
            "<div class=warning><b>Where the order of the rows does not make sense.</b> Expected is: ground truth, "
            f"then the refined grasps, then CoarseNet's, then the naive baseline.{_list(findings.surprises)}</div>"
        )
    else:
        order = (
            "<div class=fine>The rows come out in the order that they should (ground truth, refined, CoarseNet, naive "
            "baseline) wherever they differ by more than chance.</div>"
        )
    if findings.failures:
        order += f"<div class=warning><b>What could not be simulated.</b>{_list(findings.failures)}</div>"
    return (
        f"<dl class=rows>{rows}</dl>{_plain_table(findings, chosen)}{order}"
        f"{_image(intervals(findings.figures, findings.rows, chosen), 'values and intervals by row')}"
    )


def _plain_table(findings: Findings, metrics: Sequence[Metric]) -> str:
    """Metrics down, rows of the evaluation across; means over objects with their intervals."""
    if not metrics:
        return ""
    head = "".join(f"<th>{_dot(k)}{escape(row.name)}</th>" for k, row in enumerate(findings.rows))
    lines = [f"<tr><th class=metric>protocol / metric</th>{head}</tr>"]
    for metric in metrics:
        cells = (find(findings.figures, metric, row.name) for row in findings.rows)
        title = f"<th class=metric title='{escape(metric.about, quote=True)}'>{_titled(metric)}</th>"
        lines.append(f"<tr>{title}{''.join(_cell(e) for e in cells)}</tr>")
    note = "Means over objects; below, the middle 95 % of bootstrap redrawings of the grasps."
    return f"{_table(lines)}<p class=note>{note} ↓ lower is better, ↑ higher.</p>"


def _by_object(findings: Findings, metric: Metric, marks: dict[str, float] | None = None) -> str:
    """Objects across, rows of the evaluation down; `marks` is a further row of published figures."""
    things = [*findings.objects, ALL]
    lines = [f"<tr><th class=metric>{_titled(metric)}</th>{''.join(f'<th>{escape(t)}</th>' for t in things)}</tr>"]
    for k, row in enumerate(findings.rows):
        cells = (find(findings.figures, metric, row.name, t) for t in things)
        lines.append(f"<tr><th class=metric>{_dot(k)}{escape(row.name)}</th>{''.join(_cell(e) for e in cells)}</tr>")
    if marks:
        cells = "".join(f"<td>{digits(marks[t]) if t in marks else '–'}</td>" for t in things)
        lines.append(f"<tr class=published><th class=metric>GrabNet on GRAB, as published</th>{cells}</tr>")
    return _table(lines)


def _table2(findings: Findings) -> str:
    tables = [
        _by_object(findings, metric, {thing: values[k] for thing, values in reported.TABLE2.items()})
        for k, metric in enumerate(findings.of("table2"))
    ]
    note = (
        "Ground truth is compared with the ground truth of other recordings. The published figures are of other grasps "
        "and other object meshes."
    )
    return f"{''.join(tables)}<p class=note>{note}</p>" if tables else ""


def _reconstruction(findings: Findings) -> str:
    if not findings.errors:
        return ""
    head = "".join(f"<th>{s}</th>" for s in SPLITS)
    lines = [f"<tr><th class=metric>reconstruction / metric</th>{head}</tr>"]
    totals = {(e.network, e.split): e for e in findings.errors if e.object == ALL}
    for network in dict.fromkeys(e.network for e in findings.errors):
        for name in ("v2v", "v2v_mae"):
            cells = "".join(f"<td>{digits(getattr(totals[network, s], name))}</td>" for s in SPLITS)
            lines.append(f"<tr><th class=metric>{network} <b>{name}</b> [mm] ↓</th>{cells}</tr>")
        cells = "".join(f"<td>{digits(v)}</td>" for v in reported.RECONSTRUCTION[network])
        lines.append(f"<tr class=published><th class=metric>{network} v2v_mae on GRAB, as published</th>{cells}</tr>")
    frames = ", ".join(f"{totals[findings.errors[0].network, s].n:,} {s}" for s in SPLITS)
    objects = list(findings.objects)
    per_object = {(e.network, e.object): e for e in findings.errors if e.split == findings.split}
    head = "".join(f"<th>{escape(o)}</th>" for o in objects)
    by_object = [f"<tr><th class=metric>{findings.split}, v2v [mm] ↓</th>{head}</tr>"]
    for network in dict.fromkeys(e.network for e in findings.errors):
        cells = "".join(f"<td>{digits(per_object[network, o].v2v)}</td>" for o in objects)
        by_object.append(f"<tr><th class=metric>{network}</th>{cells}</tr>")
    note = (
        f"All frames: {frames}. CoarseNet reconstructs from its posterior's mean, RefineNet from disturbed true "
        "grasps. v2v is the mean Euclidean distance of vertices, v2v_mae the mean |Δ| per coordinate, which is what "
        "was published."
    )
    return f"{_table(lines)}{_table(by_object)}<p class=note>{note}</p>"


def _field(findings: Findings) -> str:
    protocols = ("halo", "grasptta", "shake", "penetration", "diversity")
    summary = _plain_table(findings, findings.of(*protocols))
    each = "".join(
        _by_object(findings, metric)
        for metric in findings.of("halo", "grasptta", "shake")
        if metric.name not in ("contact", "failed")  # what failed is told in words
    )
    head = "".join(f"<th>{h}</th>" for h in ("volume [cm³]", "contact [%]", "displacement [cm]", "cluster size [cm]"))
    lines = [f"<tr><th class=metric>reported by others</th>{head}</tr>"]
    for name, values in reported.FIELD.items():
        cells = "".join(f"<td>{'–' if v is None else digits(v)}</td>" for v in values)
        lines.append(f"<tr class=published><th class=metric>{name}</th>{cells}</tr>")
    note = "Other data, and protocols that differ three- to five-fold in their outcome: rough marks only."
    return f"{summary}<details><summary>By object</summary>{each}</details>{_table(lines)}<p class=note>{note}</p>"


def _contact(findings: Findings) -> str:
    chosen = [m for m in findings.of("contact") if m.name in ("area", "fingers", "pinched")]
    detail = [m for m in findings.of("contact") if m.name.partition("_")[2] in PARTS]
    plot = _image(fingers(findings.figures, findings.rows, findings.metrics), "contact by finger") if detail else ""
    table = (
        f"<details><summary>By finger, in numbers</summary>{_plain_table(findings, detail)}</details>" if detail else ""
    )
    return f"{_plain_table(findings, chosen)}{plot}{table}"


def _distributions(findings: Findings) -> str:
    titles = ("table2/vertices", "penetration/max", "halo/volume", "novelty/distance")
    chosen = [m for m in findings.of(*(t.partition("/")[0] for t in titles)) if m.title in titles]
    if not chosen:
        return ""
    return _image(distributions(findings.rows, chosen, list(findings.objects)), "cumulative distributions")


def _definitions(findings: Findings) -> str:
    there = {f.metric for f in findings.figures}
    lines = ["<tr><th class=metric>protocol / metric</th><th class=text>definition</th><th>grasps per object</th></tr>"]
    for m in findings.metrics:
        if m in there:
            count = f"first {m.samples}" if m.samples else "all"
            lines.append(
                f"<tr><th class=metric>{_titled(m)}</th><td class=text>{escape(m.about)}</td><td>{count}</td></tr>"
            )
    return _table(lines)


def _pictures(findings: Findings, n: int, cache: Cache) -> str:
    cards = []
    for name, mesh in findings.objects.items():
        lines = []
        for k, row in enumerate(findings.rows):
            if name not in row.hands:
                continue
            hands, found = row.hands[name], row.results[name]
            touched = found["maps"]["object"] > 0
            figures = []
            for i in range(min(n, len(hands))):
                depth, count = found["penetration"]["max"][i], found["contact"]["fingers"][i]
                caption = f"{depth:.1f} mm deep" + (f", {count:.0f} fingers" if np.isfinite(count) else "")
                figures.append(_figure(grasp_view(mesh, hands, i, touched[i], cache), caption))
            share = touched.mean(0)
            caption = f"touched by up to {100 * share.max():.0f} % of {len(hands)}"
            figures.append(_figure(heat_view(mesh, share / max(share.max(), 1e-9), cache), caption))
            lines.append(f"<h4>{_dot(k)}{escape(row.name)}</h4><div class=strip>{''.join(figures)}</div>")
        cards.append(
            f"<details{' open' if not cards else ''}><summary>{escape(name)}</summary>{''.join(lines)}</details>"
        )
    note = "The first grasps of each row, as they came. Red: contact, annotated as in the data set (paper S.7). Right: "
    note += "how often each place is touched, over all grasps, red where most often."
    return f"<p class=note>{note}</p>{''.join(cards)}"


def _titled(metric: Metric) -> str:
    unit = f" [{escape(metric.unit)}]" if metric.unit else ""
    return f"<span class=protocol>{escape(metric.protocol)}</span> {escape(metric.name)}{unit} {_ARROWS[metric.better]}"


def _cell(estimate: Any) -> str:
    if estimate is None:
        return "<td>–</td>"
    low, high = estimate.interval
    return f"<td>{digits(estimate.value)}<small>{digits(low)} … {digits(high)}</small></td>"


def _list(sentences: Iterable[str]) -> str:
    return f"<ul>{''.join(f'<li>{escape(sentence)}</li>' for sentence in sentences)}</ul>"


def _table(lines: Iterable[str]) -> str:
    head, *rest = lines
    return f"<div class=scroll><table><thead>{head}</thead><tbody>{''.join(rest)}</tbody></table></div>"


def _dot(k: int) -> str:
    return f'<i style="background:{COLOURS[k % len(COLOURS)]}"></i>'


def _image(svg: str, alt: str) -> str:
    data = base64.b64encode(svg.encode()).decode()
    return f'<img class=plot alt="{alt}" src="data:image/svg+xml;base64,{data}">'


def _figure(jpeg: bytes, caption: str) -> str:
    data = base64.b64encode(jpeg).decode()
    return (
        f'<figure><img alt="" src="data:image/jpeg;base64,{data}"><figcaption>{escape(caption)}</figcaption></figure>'
    )
