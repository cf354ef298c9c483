"""The report of a study: one page that fetches nothing, and the same numbers as CSV, LaTeX and JSON."""

from __future__ import annotations

import base64
import csv
import json
from collections import Counter
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from grabnet.cli.ends import say
from grabnet.evaluation.bootstrap import Estimate
from grabnet.io.files import replacing, write_json
from grabnet.study import plots
from grabnet.study.analysis import Analysis, AnalysisConfig, analyse, rating_shares
from grabnet.study.key import ALL
from grabnet.study.records import PLATFORM_IDS

_TEMPLATE = Path(__file__).with_name("report.html")
# Mean and deviation that the paper gives (Table 2), generated and ground truth.
_PUBLISHED = ("the paper, all: generated 4.12 (1.04)", "ground truth 4.38 (0.77)")
_MOST_PROBLEMS = 200


def run(config: AnalysisConfig) -> int:
    """Analyse a study and write what it found.

    Returns:
        the exit code: 1 where answers were left out, or the model is not to be trusted.
    """
    found = analyse(config)
    output = Path(config.output).expanduser()
    write(output, found)
    left = Counter(judged.is_kept for judged in found.judged)
    print(f"{left[True]} of {len(found.judged)} raters count, {left[False]} are left out")
    for problem in found.answers.problems[:20]:
        say(problem)
    if (more := len(found.answers.problems) - 20) > 0:
        say(f"… and {more} more, in report.html")
    if found.model is not None and found.model.caution:
        say(found.model.caution)
    print(f"{output / 'report.html'} shows all; figures are in scores.csv, table.tex and analysis.json there")
    return 1 if found.answers.problems or (found.model and found.model.caution) else 0


def write(output: Path, found: Analysis) -> None:
    """Write report.html, scores.csv, raters.csv, ratings.csv, table.tex and analysis.json."""
    _write_csv(output / "scores.csv", _score_lines(found))
    header = ["rater", "answers", "catch trials", "taken for plausible", "counts", "reason"]
    lines = [[j.rater, j.answers, j.catches, j.missed, int(j.is_kept), j.reason] for j in found.judged]
    _write_csv(output / "raters.csv", [header, *lines])
    _write_csv(output / "ratings.csv", _rating_lines(found))
    with replacing(output / "table.tex") as temporary:
        temporary.write_text(_latex(found), encoding="utf-8")
    write_json(output / "analysis.json", _summary(found))
    with replacing(output / "report.html") as temporary:
        temporary.write_text(_page(found), encoding="utf-8")


def _page(found: Analysis) -> str:
    sections = [
        ("Scores", _table2(found) if found.scores else ""),
        ("Answers", _image(plots.shares(rating_shares(found), found.levels)) if found.scores else ""),
        ("Primary test", _model(found)),
        ("Pairs", _pairs(found)),
        ("Raters", _raters(found)),
        ("Agreement", _agreement(found) if found.scores else ""),
        ("Left out", _problems(found.answers.problems)),
        ("Made with", f"<pre>{escape(json.dumps(found.record, indent=2))}</pre>"),
    ]
    main = "".join(f"<section><h2>{title}</h2>{body}</section>" for title, body in sections if body)
    n = len(found.kept)
    subtitle = f"{len(found.answers.rows):,} answers of {len(found.judged)} raters, of whom {n} count; conditions: "
    page = _TEMPLATE.read_text(encoding="utf-8")
    page = page.replace("<!--SUBTITLE-->", escape(subtitle + ", ".join(found.conditions)))
    return page.replace("<!--MAIN-->", main)


def _table2(found: Analysis) -> str:
    conditions, objects = found.ratings.conditions, found.ratings.objects
    head = "".join(f"<th>{escape(name)}<br>mean</th><th>std</th><th>n</th>" for name in conditions)
    head += "".join(f"<th>{escape(name)}<br>− {escape(conditions[0])}</th>" for name in conditions[1:])
    lines = [f"<tr><th>object</th>{head}</tr>"]
    for name in [*objects, ALL]:
        row = [found.score(condition, name) for condition in conditions]
        cells = "".join(f"{_cell(s.mean)}<td>{_number(s.std)}</td><td>{s.n}</td>" for s in row)
        cells += "".join(_cell(s.difference, signed=True) for s in row[1:])
        lines.append(f"<tr{' class=total' * (name == ALL)}><th>{escape(name)}</th>{cells}</tr>")
    note = (
        f"Answers from 1, {escape(found.levels[0])}, to {len(found.levels)}, {escape(found.levels[-1])}; std of the "
        "single answers; all: over all answers. Below the means, the middle 95 % of redrawings of raters and grasps, "
        f"both at once. For comparison, {' and '.join(_PUBLISHED)}."
    )
    plot = plots.means(found.scores, conditions, objects, len(found.levels))
    return f"{_table(lines)}<p class=note>{note}</p>{_image(plot)}"


def _model(found: Analysis) -> str:
    model = found.model
    if model is None:
        return ""
    lines = ["<tr><th>condition</th><th>object</th><th>log odds</th><th>odds ratio</th><th>P(better)</th></tr>"]
    for (condition, name), estimate in model.differences.items():
        kind = " class=total" * (name is None)
        ratio = Estimate(float(np.exp(estimate.value)), np.exp(estimate.drawn), estimate.n)
        better = _probability(float((estimate.drawn > 0).mean()), len(estimate.drawn))
        cells = f"<th>{escape(condition)}</th><td>{escape(name or 'mean of objects')}</td>"
        lines.append(f"<tr{kind}>{cells}{_cell(estimate, signed=True)}{_cell(ratio)}<td>{better}</td></tr>")
    sds = "; ".join(
        f"{name.replace('_', chr(39) + 's ')} {estimate.value:.2f}" for name, estimate in model.deviations.items()
    )
    about = (
        f"Cumulative logit model with crossed effects of raters and grasps (NumPyro, NUTS): how much the odds of a "
        f"better answer differ from those of {escape(found.conditions[0])}. Standard deviations of the "
        f"effects: {escape(sds)}."
    )
    caution = f"<div class=warning>{escape(model.caution)}</div>" if model.caution else ""
    whole = {condition: estimate for (condition, name), estimate in model.differences.items() if name is None}
    return f"{caution}{_table(lines)}<p class=note>{about}</p>{_image(plots.strengths(whole, 'log odds'))}"


def _pairs(found: Analysis) -> str:
    if not found.strengths:
        return ""
    first = found.conditions[0]
    lines = [f"<tr><th>condition</th><th>strength</th><th>chosen before {escape(first)}</th></tr>"]
    for name, estimate in found.strengths.items():
        share = Estimate(float(_odds(estimate.value)), _odds(estimate.drawn), estimate.n)
        lines.append(f"<tr><th>{escape(name)}</th>{_cell(estimate, signed=True)}{_cell(share)}</tr>")
    note = "Log strengths of Bradley and Terry's model; intervals over redrawings of raters and of pairs."
    plot = plots.strengths(found.strengths, "log strength")
    return f"{_table(lines)}<p class=note>{note}</p>{_image(plot)}"


def _raters(found: Analysis) -> str:
    reasons = Counter("answered too few catch trials" if "not" in j.reason else "took catch trials for plausible"
                      for j in found.judged if not j.is_kept)  # fmt: skip
    why = "; ".join(f"{count} {reason}" for reason, count in reasons.items()) or "none is left out"
    rule = found.record["config"]["filter"]
    text = (
        f"{len(found.kept)} of {len(found.judged)} raters count: {why}. A rater is left out who rates {rule['level']} "
        f"or more, or chooses, at least {100 * rule['share']:.0f} % of the catch trials (the paper left out 54 of 170)."
    )
    return f"<p>{escape(text)}</p>{_image(plots.raters(found.judged, rule['share']))}"


def _agreement(found: Analysis) -> str:
    return (
        f"<p>Krippendorff's alpha, ordinal: {_number(found.alpha)} on the grasps compared, "
        f"{_number(found.alpha_catches)} with catch trials.</p>"
    )


def _problems(problems: Sequence[str]) -> str:
    if not problems:
        return ""
    listed = "".join(f"<li>{escape(problem)}</li>" for problem in problems[:_MOST_PROBLEMS])
    more = len(problems) - _MOST_PROBLEMS
    rest = f"<p>… and {more} more.</p>" if more > 0 else ""
    return f"<details open><summary>{len(problems)} times</summary><ul>{listed}</ul>{rest}</details>"


def _score_lines(found: Analysis) -> list[list[Any]]:
    lines: list[list[Any]] = [
        ["object", "condition", "n", "mean", "low", "high", "std", "difference", "difference_low", "difference_high"]
    ]
    for s in found.scores:
        difference = [s.difference.value, *s.difference.interval] if s.difference.n else ["", "", ""]
        lines.append([s.object, s.condition, s.n, s.mean.value, *s.mean.interval, s.std, *difference])
    for name, estimate in found.strengths.items():
        lines.append([ALL, name, estimate.n, "", "", "", "", estimate.value, *estimate.interval])
    return lines


def _rating_lines(found: Analysis) -> list[list[Any]]:
    kept, videos = set(found.kept), found.answers.videos
    lines = [["rater", *PLATFORM_IDS, "object", "condition", "grasp", "shown", "answer", "seconds", "counts"]]
    for row in found.answers.rows:
        shown = [videos[name] for name in row.videos]
        lines.append([
            row.rater, *(row.platform.get(name, "") for name in PLATFORM_IDS), shown[0].object,
            " | ".join(s.condition for s in shown), " | ".join(str(s.grasp) for s in shown), " | ".join(row.videos),
            row.answer, "" if row.seconds is None else row.seconds, int(row.rater in kept),
        ])  # fmt: skip
    return lines


def _latex(found: Analysis) -> str:
    """Table 2's columns of the user study."""
    if not found.scores:
        rows = [
            f"{_escaped(n)} & {e.value:.2f} & {e.interval[0]:.2f} & {e.interval[1]:.2f} \\\\"
            for n, e in found.strengths.items()
        ]
        return _tabular("lrrr", "condition & strength & low & high", rows)
    conditions = found.ratings.conditions
    heads = " & ".join(rf"\multicolumn{{2}}{{c}}{{{_escaped(name)}}}" for name in conditions)
    rows = []
    for name in [*found.ratings.objects, ALL]:
        cells = [found.score(condition, name) for condition in conditions]
        values = " & ".join(f"{_number(s.mean.value)} & {_number(s.std)}" for s in cells)
        rows.append(rf"{_escaped(name)} & {values} \\")
    head = rf"& {heads} \\" + "\nobject " + "& mean & std " * len(conditions)
    return _tabular("l" + "rr" * len(conditions), head.strip(), rows)


def _tabular(columns: str, head: str, rows: Iterable[str]) -> str:
    lines = [
        rf"\begin{{tabular}}{{{columns}}}",
        r"\hline",
        rf"{head} \\",
        r"\hline",
        *rows,
        r"\hline",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def _summary(found: Analysis) -> dict[str, Any]:
    def estimate(value: Estimate) -> dict[str, float | None]:
        low, high = value.interval
        return {name: _finite(v) for name, v in (("value", value.value), ("low", low), ("high", high))}

    model = found.model
    return {
        "raters": {"all": len(found.judged), "kept": len(found.kept)},
        "scores": [
            {"object": s.object, "condition": s.condition, "n": s.n, "std": _finite(s.std), "mean": estimate(s.mean),
             "difference": estimate(s.difference) if s.difference.n else None}
            for s in found.scores
        ],
        "model": model and {
            "differences": [
                {"condition": c, "object": o or ALL, **estimate(e)} for (c, o), e in model.differences.items()
            ],
            "deviations": {name: estimate(e) for name, e in model.deviations.items()},
            "caution": model.caution,
        },
        "strengths": {name: estimate(e) for name, e in found.strengths.items()},
        "alpha": {"shown": _finite(found.alpha), "with_catch_trials": _finite(found.alpha_catches)},
        "left_out": found.answers.problems,
        **found.record,
    }  # fmt: skip


def _probability(share: float, draws: int) -> str:
    """A share of draws, which tell none below one in their number."""
    least = 1 / draws
    return f"&lt; {least:.3f}" if share < least else f"&gt; {1 - least:.3f}" if share > 1 - least else f"{share:.3f}"


def _odds(strength):
    return 1 / (1 + np.exp(-strength))


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _number(value: float, signed: bool = False) -> str:
    return "–" if not np.isfinite(value) else f"{value:+.2f}" if signed else f"{value:.2f}"


def _cell(estimate: Estimate, signed: bool = False) -> str:
    if not estimate.n:
        return "<td>–</td>"
    low, high = (_number(value, signed) for value in estimate.interval)
    return f"<td>{_number(estimate.value, signed)}<small>{low} … {high}</small></td>"


def _table(lines: Iterable[str]) -> str:
    head, *rest = lines
    return f"<div class=scroll><table><thead>{head}</thead><tbody>{''.join(rest)}</tbody></table></div>"


def _image(svg: str) -> str:
    return f'<img alt="" src="data:image/svg+xml;base64,{base64.b64encode(svg.encode()).decode()}">'


def _escaped(text: str) -> str:
    special = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    special |= {c: "\\" + c for c in "&%$#_{}"}
    return "".join(special.get(c, c) for c in text)


def _write_csv(path: Path, lines: Iterable[Sequence[Any]]) -> None:
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([_harmless(value) for value in line] for line in lines)


def _harmless(value: Any) -> Any:
    """A text that a spreadsheet does not take for a formula."""
    return f"'{value}" if isinstance(value, str) and value[:1] in ("=", "+", "-", "@", "\t", "\r") else value
