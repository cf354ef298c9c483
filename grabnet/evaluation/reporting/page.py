"""The report: one HTML page with all tables, plots and pictures in it, which fetches nothing from anywhere."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Sequence
from html import escape
from itertools import groupby
from pathlib import Path

import numpy as np

from grabnet.cli.numbers import digits
from grabnet.cli.progress import track
from grabnet.data.splits import SPLITS
from grabnet.evaluation.bootstrap import Estimate
from grabnet.evaluation.cache import Cache
from grabnet.evaluation.methods import Method
from grabnet.evaluation.metrics import ALL, Metric, Section
from grabnet.evaluation.reporting import published
from grabnet.evaluation.reporting.findings import Findings
from grabnet.evaluation.reporting.plots import COLOURS, distributions, intervals, parts
from grabnet.evaluation.reporting.views import grasp_view, heat_view
from grabnet.evaluation.summary import expected_order, find
from grabnet.io.files import replacing
from grabnet.visual.pictures import can_render

_TEMPLATE = Path(__file__).with_name("page.html")
_ARROWS = {"lower": "↓", "higher": "↑", None: ""}


def write_report(path: Path, findings: Findings, pictures: int, cache: Cache) -> None:
    """Write the page, atomically.

    Args:
        path: of the page.
        findings: what it shows.
        pictures: grasps drawn per object and row; none where this machine cannot draw.
        cache: of pictures.
    """
    reason = can_render() if pictures else "No pictures were asked for."
    sections = [
        ("At a glance", _glance(findings)),
        ("Grasps", _note(reason) if reason else _pictures(findings, pictures, cache)),
        *((section.title, _section(findings, section)) for section in findings.sections),
        ("Distributions", _distributions(findings)),
        ("Definitions", _definitions(findings)),
        ("Made with", f"<pre>{escape(json.dumps(findings.record, indent=2))}</pre>"),
    ]
    sections = [(title, body) for title, body in sections if body]
    contents = "".join(f'<a href="#s{k}">{escape(title)}</a>' for k, (title, _) in enumerate(sections))
    main = "".join(
        f'<section id="s{k}"><h2>{escape(title)}</h2>{body}</section>' for k, (title, body) in enumerate(sections)
    )
    page = _TEMPLATE.read_text(encoding="utf-8")
    for name, text in {"SUBTITLE": escape(_subtitle(findings)), "CONTENTS": contents, "MAIN": main}.items():
        page = page.replace(f"<!--{name}-->", text)
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _subtitle(findings: Findings) -> str:
    grasps = sum(len(hands) for method in findings.methods for hands in method.hands.values())
    n = len(findings.objects)
    return (
        f"{grasps:,} grasps of {n} {findings.split} object{'s' * (n != 1)} by {len(findings.methods)} rows; "
        f"made {findings.record['provenance']['made'][:10]}"
    )


def _glance(findings: Findings) -> str:
    methods, chosen = findings.methods, findings.headlines
    rows = "".join(
        f"<dt>{_dot(k)}{escape(method.name)}</dt><dd>{escape(method.about)}</dd>" for k, method in enumerate(methods)
    )
    expected = escape(expected_order(methods))
    if findings.unexpected_order:
        order = (
            "<div class=warning><b>Where the order of the rows does not make sense.</b> Expected is: "
            f"{expected}.{_list(findings.unexpected_order)}</div>"
        )
    else:
        order = (
            f"<div class=fine>The rows come out in the order that they should ({expected}) wherever they differ by "
            "more than chance.</div>"
        )
    if findings.failures:
        order += f"<div class=warning><b>What could not be measured.</b>{_list(findings.failures)}</div>"
    plot = _image(intervals(findings.figures, methods, chosen), "values and intervals by row") if chosen else ""
    return f"<dl class=rows>{rows}</dl>{_by_row(findings, chosen)}{order}{plot}"


def _section(findings: Findings, section: Section) -> str:
    """All of a section's metrics: of networks; by row; by object; by part of the hand; as reported by others."""
    metrics = [metric for metric in findings.measured if metric.section == section]
    whole, of_parts = [m for m in metrics if not m.part], [m for m in metrics if m.part]
    scored = [metric for metric in findings.scored if metric.section == section]
    scores = "".join(_scores(findings, p, list(group)) for p, group in groupby(scored, key=lambda m: m.protocol))
    by_object = [metric for metric in findings.by_object if metric.section == section]
    tables = "".join(_by_object(findings, metric) for metric in by_object)
    is_open = any(metric.title in published.BY_OBJECT for metric in by_object)
    plot = _image(parts(findings.figures, findings.methods, of_parts), "by part of the hand") if of_parts else ""
    detail = _folded("By part of the hand, in numbers", _by_row(findings, of_parts))
    return (
        f"{scores}{_by_row(findings, whole)}{_folded('By object', tables, is_open)}{plot}{detail}"
        f"{_reported(metrics)}{_note(section.note)}"
    )


def _by_row(findings: Findings, metrics: Sequence[Metric]) -> str:
    """Metrics down, rows of the evaluation across; means over objects with their intervals."""
    if not metrics:
        return ""
    head = "".join(f"<th>{_dot(k)}{escape(method.name)}</th>" for k, method in enumerate(findings.methods))
    lines = [f"<tr><th class=metric>protocol / metric</th>{head}</tr>"]
    for metric in metrics:
        cells = (find(findings.figures, metric, method.name) for method in findings.methods)
        title = f"<th class=metric title='{escape(metric.about, quote=True)}'>{_titled(metric)}</th>"
        lines.append(f"<tr>{title}{''.join(_cell(e) for e in cells)}</tr>")
    note = (
        "Means over objects; below, the middle 95 % of bootstrap redrawings of the grasps. ↓ lower is better, ↑ higher."
    )
    return f"{_table(lines)}{_note(note)}"


def _by_object(findings: Findings, metric: Metric) -> str:
    """Objects across, rows of the evaluation down, then published figures."""
    names = [*findings.objects, ALL]
    lines = [f"<tr><th class=metric>{_titled(metric)}</th>{_heads(names)}</tr>"]
    for k, method in enumerate(findings.methods):
        cells = "".join(_cell(find(findings.figures, metric, method.name, name)) for name in names)
        lines.append(f"<tr><th class=metric>{_dot(k)}{escape(method.name)}</th>{cells}</tr>")
    if marks := published.BY_OBJECT.get(metric.title):
        lines.append(_marks(published.SOURCE, [marks.get(name) for name in names]))
    return _table(lines)


def _scores(findings: Findings, protocol: str, metrics: Sequence[Metric]) -> str:
    """A protocol's metrics of networks: by split, and by object of the evaluation's split."""
    scores = findings.scores[protocol]
    by_place = {(s.network, s.split, s.object): s for s in scores}
    networks = list(dict.fromkeys(s.network for s in scores))
    splits = [split for split in SPLITS if any(s.split == split for s in scores)]
    lines = [f"<tr><th class=metric>{escape(protocol)} / metric</th>{_heads(splits)}</tr>"]
    for network in networks:
        for metric in metrics:
            values = (by_place[network, split, ALL].values[metric.name] for split in splits)
            lines.append(_marks(f"{network}, {metric.label}", values, kind=""))
            if marks := published.OF_NETWORKS.get(metric.title, {}).get(network):
                lines.append(_marks(f"{network}, {metric.name}: {published.SOURCE}", map(marks.get, splits)))
    objects = [name for name in findings.objects if (networks[0], findings.split, name) in by_place]
    by_object = [f"<tr><th class=metric>{escape(protocol)}, {findings.split}</th>{_heads(objects)}</tr>"]
    for network in networks:
        for metric in metrics:
            values = (by_place[network, findings.split, name].values[metric.name] for name in objects)
            by_object.append(_marks(f"{network}, {metric.label}", values, kind=""))
    frames = ", ".join(f"{by_place[networks[0], split, ALL].n:,} {split}" for split in splits)
    return f"{_table(lines)}{_table(by_object)}{_note(f'All frames: {frames}.')}"


def _reported(metrics: Sequence[Metric]) -> str:
    """Those of the metrics that other works report."""
    columns = [m for m in metrics if any(m.title in marks for marks in published.BY_OTHERS.values())]
    if not columns:
        return ""
    names = [f"{m.name} [{m.unit}]" for m in columns]
    lines = [f"<tr><th class=metric>reported by others</th>{_heads(names)}</tr>"]
    lines += [
        _marks(work, [marks.get(m.title) for m in columns])
        for work, marks in published.BY_OTHERS.items()
        if any(m.title in marks for m in columns)
    ]
    return _table(lines)


def _distributions(findings: Findings) -> str:
    chosen = [metric for metric in findings.measured if metric.distribution]
    if not chosen:
        return ""
    return _image(distributions(findings.methods, chosen, list(findings.objects)), "cumulative distributions")


def _definitions(findings: Findings) -> str:
    there = {*findings.measured, *findings.scored}
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
    for name, mesh in track(findings.objects.items(), "Drawing grasps"):
        lines = []
        for k, method in enumerate(findings.methods):
            if name not in method.hands:
                continue
            hands, red = method.hands[name], findings.highlighted(method, name)
            figures = [
                _figure(grasp_view(mesh, hands, i, red[i], cache), _caption(findings.metrics, method, name, i))
                for i in range(min(n, len(hands)))
            ]
            share = red.mean(0)
            caption = f"red in up to {100 * share.max():.0f} % of {len(hands)}"
            figures.append(_figure(heat_view(mesh, share / max(share.max(), 1e-9), cache), caption))
            lines.append(f"<h4>{_dot(k)}{escape(method.name)}</h4><div class=strip>{''.join(figures)}</div>")
        cards.append(_folded(escape(name), "".join(lines), is_open=not cards))
    note = "The first grasps of each row, as they came."
    if findings.highlight is not None:
        note += f" {findings.highlight.legend} Right: how often over all grasps, red where most often."
    return f"{_note(note)}{''.join(cards)}"


def _caption(metrics: Sequence[Metric], method: Method, object_name: str, i: int) -> str:
    words = []
    for metric in metrics:
        values = method.results[object_name].get(metric.title, ()) if metric.caption or metric.mark else ()
        if i < len(values) and np.isfinite(values[i]):
            words += [metric.caption.format(values[i] * metric.scale)] if metric.caption else []
            words += [metric.mark] if metric.mark and values[i] else []
    return ", ".join(words)


def _titled(metric: Metric) -> str:
    unit = f" [{escape(metric.unit)}]" if metric.unit else ""
    return f"<span class=protocol>{escape(metric.protocol)}</span> {escape(metric.name)}{unit} {_ARROWS[metric.better]}"


def _cell(estimate: Estimate | None) -> str:
    if estimate is None:
        return "<td>–</td>"
    low, high = estimate.interval
    return f"<td>{digits(estimate.value)}<small>{digits(low)} … {digits(high)}</small></td>"


def _marks(title: str, values: Iterable[float | None], kind: str = " class=published") -> str:
    """A line of numbers without intervals."""
    cells = "".join(f"<td>{'–' if value is None else digits(value)}</td>" for value in values)
    return f"<tr{kind}><th class=metric>{escape(title)}</th>{cells}</tr>"


def _heads(names: Iterable[str]) -> str:
    return "".join(f"<th>{escape(name)}</th>" for name in names)


def _note(text: str) -> str:
    return f"<p class=note>{escape(text)}</p>" if text else ""


def _folded(summary: str, body: str, is_open: bool = False) -> str:
    return f"<details{' open' * is_open}><summary>{summary}</summary>{body}</details>" if body else ""


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
