"""The report: one HTML page with all tables, figures and meshes in it, which fetches nothing from anywhere."""

from __future__ import annotations

import base64
import gzip
import io
import json
import math
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_hex
from PIL import Image

from grabnet.analysis.frames import ALL
from grabnet.analysis.plots import difference_colours, heat_colours
from grabnet.analysis.report.findings import Findings, Section
from grabnet.analysis.report.meshes import colourings, heats_glb
from grabnet.analysis.statistic import Row
from grabnet.cli.numbers import digits
from grabnet.io.files import replacing

_TEMPLATE = Path(__file__).with_name("page.html")
# Turn about the vertical and tilt, radians, of the views of meshes.
_SIDES = {
    "aslant": "0.5 0.2", "the front": "0 0", "the back": "3.1416 0", "its left": "1.5708 0", "its right": "-1.5708 0",
    "above": "0 1.5708", "below": "0 -1.5708",
}  # fmt: skip
# Of the bars below the meshes, from end to end.
_STOPS = np.linspace(0, 1, 17)
_WEBP_MOST = 16_383  # pixels of a side
# Lines of a table that are seen without unfolding it.
_SHORT = 12


def write_page(path: Path, findings: Findings, figures: Path) -> None:
    """Write the page, atomically.

    Args:
        path: of the page.
        findings: what it shows.
        figures: folder of the figures, `<statistic>.png`.
    """
    sections = [
        ("Agreement with the paper", _agreement(findings)),
        *((section.title, _section(section, figures, findings.no_pictures)) for section in findings.sections),
        ("In 3-D", _viewer(findings)),
        ("Made with", f"<pre>{escape(json.dumps(findings.record, indent=2))}</pre>"),
    ]
    contents = "".join(f'<a href="#s{k}">{escape(title)}</a>' for k, (title, _) in enumerate(sections))
    main = "".join(
        f'<section id="s{k}"><h2>{escape(title)}</h2>{body}</section>' for k, (title, body) in enumerate(sections)
    )
    parts = {"SUBTITLE": escape(_subtitle(findings)), "CONTENTS": contents, "MAIN": main, "MESHES": _meshes(findings)}
    parts |= {"HEAT": _gradient(heat_colours(_STOPS, 1)), "CHANGE": _gradient(difference_colours(2 * _STOPS - 1, 1))}
    page = _TEMPLATE.read_text(encoding="utf-8")
    for name, text in parts.items():
        page = page.replace(f"<!--{name}-->", text)
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _subtitle(findings: Findings) -> str:
    labels = " and ".join(each.label for each in findings.analysed)
    about = f"{labels}; shown: {findings.subset}; made {findings.record['made'][:10]}"
    return f"{about}; a click on a figure shows it in full size"


def _agreement(findings: Findings) -> str:
    first = findings.analysed[0]
    parts = []
    if findings.failures:
        items = "".join(f"<li>{escape(sentence)}</li>" for sentence in findings.failures)
        parts.append(f"<div class=warning><b>What is missing.</b><ul>{items}</ul></div>")
    if first.data.is_synthetic:
        parts.append(
            f"<div class=warning>The data set “{escape(first.label)}” is synthetic: nobody was recorded. The published "
            "numbers, which are of GRAB, stand beside its own for orientation; it need not agree with them.</div>"
        )
    if findings.subset != ALL:
        parts.append(_note(f"Only a subset is counted here ({findings.subset}); the published numbers are of all."))
    return "".join(parts) + _table(findings.agreement)


def _section(section: Section, figures: Path, no_pictures: str | None) -> str:
    parts = [_note(section.about)]
    if not any(section.tables.values()):
        return f"{parts[0]}<p>There are no such frames in what was chosen.</p>"
    if section.is_drawn:
        parts.append(_image(figures / f"{section.name}.png", section.title))
    else:
        parts.append(f"<p>{escape(no_pictures or 'Nothing was touched in what was chosen, so nothing is drawn.')}</p>")
    for label, rows in section.tables.items():
        title = f"{escape(label)}: {len(rows)} lines"
        body = _table(rows) if rows else "<p>There are no such frames in what was chosen.</p>"
        parts.append(f"<details{' open' * (len(rows) <= _SHORT)}><summary>{title}</summary>{body}</details>")
    return "".join(parts)


def _viewer(findings: Findings) -> str:
    if not findings.heats:
        return "<p>There are no meshes coloured by contact: nothing was touched, or scenes=false.</p>"
    options = "".join(f"<option>{escape(name)}</option>" for name in findings.heats)
    sides = "".join(f'<option value="{turn}">{escape(name)}</option>' for name, turn in _SIDES.items())
    return (
        f"<p><label>Mesh <select id=mesh>{options}</select></label> <label>Shown <select id=heat></select></label> "
        f"<label>From <select id=side>{sides}</select></label> "
        "<span class=note>drag to turn, wheel to zoom</span></p><canvas id=view></canvas>"
        "<div class=scale><span id=low></span><i id=bar></i><span id=high></span></div>"
    )


def _meshes(findings: Findings) -> str:
    """JSON that stays within a script element: each mesh as a compressed .glb, and the scales of its colourings."""
    meshes = []
    for heats in findings.heats.values():
        scales = {name: [each.low, each.high, each.is_change] for name, each in colourings(heats).items()}
        meshes.append({"glb": base64.b64encode(gzip.compress(heats_glb(heats))).decode(), "scales": scales})
    return json.dumps(meshes).replace("<", "\\u003c")


def _gradient(colours: np.ndarray) -> str:
    """(N, 3) colours in [0, 1] as CSS."""
    return ", ".join(to_hex(colour) for colour in colours)


def _table(rows: Sequence[Row]) -> str:
    if not rows:
        return ""
    head = "".join(f"<th{_kind(value)}>{escape(name)}</th>" for name, value in rows[0].items())
    lines = "".join(f"<tr>{_cells(row.values())}</tr>" for row in rows)
    return f"<div class=scroll><table><thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table></div>"


def _cells(values: Iterable[Any]) -> str:
    return "".join(f"<td{_kind(value)}>{escape(_text(value))}</td>" for value in values)


def _kind(value: Any) -> str:
    return " class=text" if isinstance(value, str) else ""


def _text(value: Any) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, int):
        return f"{value:,}"
    return value if isinstance(value, str) else digits(value)


def _note(text: str) -> str:
    return f"<p class=note>{escape(text)}</p>"


def _image(path: Path, alt: str) -> str:
    """The picture as WebP, which takes a third of the PNG file, where that format can hold it."""
    kind, data = "png", path.read_bytes()
    with Image.open(path) as picture:
        if max(picture.size) <= _WEBP_MOST:
            buffer = io.BytesIO()
            picture.convert("RGB").save(buffer, "WEBP", quality=88)
            kind, data = "webp", buffer.getvalue()
    data = base64.b64encode(data).decode()
    image = f'<img class=plot alt="{escape(alt, quote=True)}" src="data:image/{kind};base64,{data}">'
    return f"<div class=figure>{image}</div>"
