"""From a data set to its report: what `grabnet analyze` does.

The folder gets
    report.html                 all tables, figures and meshes in one file
    figures/<statistic>.png, .pdf
    numbers/<statistic>_<label>.csv   a line for each row; _difference.csv of two data sets
    numbers.json                the same, with settings and versions
    meshes/*.ply                bodies and objects coloured by contact, with the likelihood as a property
    counted/<label>/            what each sequence adds, so that a run that was stopped, or another subset, continues
"""

from __future__ import annotations

import csv
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from grabnet.analysis.accumulating import Accumulation, accumulate
from grabnet.analysis.comparing import difference
from grabnet.analysis.config import AnalyzeConfig
from grabnet.analysis.published import agreement
from grabnet.analysis.registry import STATISTICS
from grabnet.analysis.report.findings import DIFFERENCE, Findings, Section
from grabnet.analysis.report.meshes import write_heats
from grabnet.analysis.report.page import write_page
from grabnet.analysis.statistic import Analysed, Row
from grabnet.analysis.statistics.clusters import Clusters
from grabnet.cli.ends import say
from grabnet.cli.progress import track
from grabnet.errors import UserError
from grabnet.io.files import filling, replacing, write_json
from grabnet.io.locks import alone_in
from grabnet.io.provenance import provenance
from grabnet.visual.pictures import can_render

# The report last: where it lies, all others are those that it shows.
RESULTS = (
    "figures/*.png", "figures/*.pdf", "numbers/*.csv", "meshes/*.ply", "numbers.json", "report.html",
)  # fmt: skip


def run(config: AnalyzeConfig) -> int:
    """Analyse, and say what failed; the exit code."""
    failures = analyze(config)
    print(f"Wrote {config.root / 'report.html'}.")
    for sentence in failures:
        say(sentence)
    return 1 if failures else 0


def analyze(config: AnalyzeConfig) -> list[str]:
    """Count, and write everything; in sentences, why sequences could not be counted, and what of a subset is nowhere.

    Raises:
        UserError: no sequences, an object to choose that has no mesh, or an output that holds another analysis.
    """
    start, failures, analysed, groups, markers = time.monotonic(), [], [], set(), []
    names = [data.names() for data in config.data_sets]
    for group, data in zip(("data", "compare"), config.data_sets, strict=False):
        # Read once, here: workers get them, and what is wrong with them is said before hours of counting.
        _ = data.surface, data.objects()
        markers.append(data.object_markers(f"{group}.markers"))
    objects = sorted({name for data in config.data_sets for name in data.objects()})
    if unknown := [name for name in config.objects or () if name not in objects]:
        raise UserError(f"objects names {', '.join(unknown)}: there are {', '.join(objects)}.")
    with alone_in(config.root, "output"), filling(config.root, RESULTS, _is_ours) as folder:
        for data, sequences, on_objects in zip(config.data_sets, names, markers, strict=True):
            work = Accumulation(data, STATISTICS, config.rules, config.root / "counted" / data.label)
            statistics, failed, there = accumulate(
                work, sequences, config.workers, config.max_deaths, config.dask_address, config.subset
            )
            failures += [f"{outcome.name}: {outcome.failure}" for outcome in failed]
            groups |= there
            statistics[Clusters.name].markers = on_objects
            analysed.append(Analysed(data, statistics))
        failures += [f"Nothing that was counted has the chosen {what}." for what in config.subset.missing(groups)]
        findings = _findings(config, folder, analysed, failures, time.monotonic() - start)
        _write(folder, findings)
    return failures


def _is_ours(folder: Path) -> bool:
    return any(folder.glob("counted/*/recipe.json"))


def _findings(
    config: AnalyzeConfig, folder: Path, analysed: Sequence[Analysed], failures: Sequence[str], seconds: float
) -> Findings:
    """Tables and meshes of all statistics; their figures are written to a folder at once, for the sake of memory."""
    sections, heats = [], {}
    for kind in track(STATISTICS, "Drawing figures"):
        tables = {each.label: each.rows(kind) for each in analysed}
        figure = kind.draw(analysed) if any(tables.values()) else None
        if figure is not None:
            save_figure(folder / "figures", kind.name, figure)
        if config.scenes:
            for name, mesh in kind.heats(analysed).items():
                heats[name if name not in heats else f"{name} ({kind.title})"] = mesh  # an object may be called "head"
        sections.append(Section(kind.name, kind.title, kind.about, tables, figure is not None))
    if len(analysed) > 1:
        first, second = analysed
        for section in sections:
            rows = difference(section.tables[first.label], section.tables[second.label])
            section.tables[DIFFERENCE] = rows
    tables = {section.name: section.tables[analysed[0].label] for section in sections}
    record = provenance(
        data={each.label: each.data.recipe() for each in analysed},
        rules=asdict(config.rules),
        subset=str(config.subset),
        seconds=round(seconds, 1),
    )
    return Findings(analysed, config.subset, sections, agreement(tables), heats, failures, can_render(), record)


def _write(root: Path, findings: Findings) -> None:
    for section in findings.sections:
        for label, rows in section.tables.items():
            write_csv(root / "numbers" / f"{section.name}_{label}.csv", rows)
    write_csv(root / "numbers" / "agreement.csv", findings.agreement)
    for name, heat in findings.heats.items():
        write_heats(root / "meshes", name, heat)
    numbers = {section.name: section.tables for section in findings.sections} | {"agreement": findings.agreement}
    write_json(root / "numbers.json", {"record": findings.record, "numbers": _finite(numbers)})
    write_page(root / "report.html", findings, root / "figures")


def save_figure(folder: Path, name: str, figure: Figure) -> None:
    """Write a figure as PNG and PDF."""
    for suffix, about in ((".png", {"Software": None}), (".pdf", {"CreationDate": None})):
        with replacing(folder / f"{name}{suffix}") as temporary:
            figure.savefig(temporary, dpi=130, metadata=about)
        figure.set_layout_engine("none")  # what was laid out once stays, and costs half


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write lines of a table under their columns' names; an empty file where there are none."""
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        if rows:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)


def _finite(value):
    """JSON has no NaN: null stands for a share of nothing."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
