"""Evaluating grasps: what `scripts/evaluate.py` does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from grabnet.cli.ends import note, say
from grabnet.evaluation.config import EvaluationConfig
from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.measuring import Task, measured
from grabnet.evaluation.methods import Method, make_methods
from grabnet.evaluation.protocol import EvaluationProtocol, MeasuredGrasps, PerGrasp, PerMethod, PerNetwork, PerObject
from grabnet.evaluation.registry import protocols_of
from grabnet.evaluation.reporting.findings import Findings, Highlight
from grabnet.evaluation.reporting.page import write_report
from grabnet.evaluation.reporting.tables import write_csv, write_grasps_csv, write_json_tables, write_latex
from grabnet.evaluation.summary import failures, figures, unexpected_order
from grabnet.io.litter import clear_litter
from grabnet.io.provenance import provenance


def run(config: EvaluationConfig) -> int:
    """Measure, and write report.html, metrics.json, metrics.csv, grasps.csv, tables.tex and the protocols' own files to
    the output folder.

    Returns:
        Exit code: 0 where all was measured; 1 where some grasps could not be, or a folder has none of an object.

    Raises:
        UserError: data, networks or grasps that are missing or do not fit.
    """
    output = Path(config.output).expanduser()
    clear_litter(output, "*.*", "*/*/*.*")
    torch.set_num_threads(torch.get_num_threads())  # said explicitly, MKL keeps to it: sums in the same order each time
    inputs = EvaluationInputs(config)
    protocols = protocols_of(inputs)
    methods = make_methods(inputs)
    measure(inputs, protocols, methods)
    findings = _findings(inputs, protocols, methods)
    write_json_tables(output / "metrics.json", findings)
    write_csv(output / "metrics.csv", findings)
    write_grasps_csv(output / "grasps.csv", findings)
    write_latex(output / "tables.tex", findings)
    for protocol in protocols:
        protocol.write(output, methods, inputs)
    write_report(output / "report.html", findings, config.pictures, inputs.cache)
    for sentence in findings.failures:
        say(sentence)
    note(f"{output / 'report.html'} shows all; figures are in metrics.json, metrics.csv and tables.tex there")
    is_whole = all(name in method.hands for method in methods for name in inputs.objects)
    return 0 if is_whole and not findings.failures else 1


def measure(inputs: EvaluationInputs, protocols: Sequence[EvaluationProtocol], methods: Sequence[Method]) -> None:
    """Fill in the methods' results and estimates."""
    per_grasp = [protocol for protocol in protocols if isinstance(protocol, PerGrasp)]
    per_object = [protocol for protocol in protocols if isinstance(protocol, PerObject)]
    of_truth = tuple(kind for protocol in per_object for kind in protocol.of_truth)
    for protocol in per_grasp:
        protocol.prepare(list(inputs.meshes.values()), inputs.config.processes)
    tasks = []
    for name, mesh in inputs.meshes.items():
        truth = inputs.truth[name]
        for method in methods:
            if name in method.hands:
                tasks.append(Task((method.name, name, "method"), mesh, method.hands[name], per_grasp, truth))
        needed = [protocol for protocol in per_grasp if isinstance(protocol, of_truth)]
        tasks.append(Task(("", name, "truth"), mesh, truth, needed, truth))
    results = measured(tasks, inputs.cache, inputs.config.processes)
    for method in methods:
        for name, hands in method.hands.items():
            method.results[name] = results[method.name, name, "method"]
            grasps = MeasuredGrasps(
                mesh=inputs.meshes[name],
                hands=hands,
                truth=inputs.truth[name],
                results=method.results[name],
                truth_results=results["", name, "truth"],
            )
            for protocol in per_object:
                for result, values in protocol(grasps).items():
                    method.results[name][f"{protocol.name}/{result}"] = values
        for protocol in protocols:
            if isinstance(protocol, PerMethod):
                for result, estimate in protocol(method).items():
                    method.estimates[f"{protocol.name}/{result}"] = estimate


def _findings(inputs: EvaluationInputs, protocols: Sequence[EvaluationProtocol], methods: Sequence[Method]) -> Findings:
    config = inputs.config
    metrics = [metric for protocol in protocols for metric in protocol.metrics]
    numbers = figures(methods, metrics, inputs.objects, config.draws, config.seed)
    per_grasp = [protocol for protocol in protocols if isinstance(protocol, PerGrasp)]
    highlights = [Highlight(f"{p.name}/{p.highlight}", p.legend) for p in per_grasp if p.highlight]
    return Findings(
        methods=methods,
        objects=inputs.meshes,
        metrics=metrics,
        figures=numbers,
        scores={protocol.name: protocol() for protocol in protocols if isinstance(protocol, PerNetwork)},
        unexpected_order=unexpected_order(numbers, methods, metrics),
        failures=failures(methods, [protocol.name for protocol in per_grasp], inputs.objects),
        highlight=highlights[0] if highlights else None,
        split=config.split,
        record=_record(inputs),
    )


def _record(inputs: EvaluationInputs) -> dict[str, Any]:
    """Return what the figures were made with."""
    return {
        "models": {model.name: model.record() for model in inputs.models},
        "data": {
            "store": str(inputs.data.store_dir),
            "provenance": inputs.store.card["provenance"],
            "objects_sha256": {name: mesh.sha256 for name, mesh in inputs.meshes.items()},
            "ground_truth_grasps": {name: len(hands) for name, hands in inputs.truth.items()},
        },
        "hand_sha256": inputs.hand.fingerprint,
        "config": asdict(inputs.config),
        "provenance": provenance(),
    }
