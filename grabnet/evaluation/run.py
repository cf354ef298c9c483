"""Evaluating grasps: what `scripts/evaluate.py` does."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from hydra.utils import instantiate

from grabnet.evaluation.inputs import Material
from grabnet.evaluation.measuring import Task, measured
from grabnet.evaluation.metrics import Metric
from grabnet.evaluation.models import EvaluatedModel, load_models
from grabnet.evaluation.protocols import diversity
from grabnet.evaluation.protocols.contact import FingerContact, vertex_areas
from grabnet.evaluation.protocols.contact_maps import ContactMaps, write_maps
from grabnet.evaluation.protocols.grasptta import GraspTTA
from grabnet.evaluation.protocols.ground_truth import CLOSEST_MAP, ClosestHand, closest_map_error, same_sequence
from grabnet.evaluation.protocols.halo import Halo
from grabnet.evaluation.protocols.holding import Holding, reasons
from grabnet.evaluation.protocols.penetration import Penetration
from grabnet.evaluation.protocols.posture import Posture
from grabnet.evaluation.protocols.reconstruction import Errors, reconstruction
from grabnet.evaluation.reporting.page import Findings, write_report
from grabnet.evaluation.reporting.tables import write_csv, write_grasps_csv, write_json_tables, write_latex
from grabnet.evaluation.rows import make_rows
from grabnet.evaluation.settings import Evaluation
from grabnet.evaluation.summary import Row, figures, surprises
from grabnet.generation.config import usable_device
from grabnet.io.files import sha256
from grabnet.io.provenance import provenance


def evaluate(wanted: Evaluation) -> None:
    """Measure, and write report.html, metrics.json, metrics.csv, grasps.csv, tables.tex and contact/ to the output
    folder.

    Raises:
        UserError: data, networks or grasps that are missing or do not fit.
    """
    torch.set_num_threads(torch.get_num_threads())  # said explicitly, MKL keeps to it: sums in the same order each time
    material = Material(wanted)
    models = load_models(wanted.models, material.hand, wanted.runs, usable_device(wanted.device))
    rows = make_rows(material, models)
    metrics = _measure(material, rows)
    found = figures(rows, metrics, material.objects, wanted.draws, wanted.seed)
    findings = Findings(
        rows=rows,
        objects=material.meshes,
        metrics=metrics,
        figures=found,
        errors=_reconstruction(material, models),
        surprises=surprises(found, rows, metrics),
        failures=_failures(rows, material.objects),
        split=wanted.split,
        record=_record(material, models),
    )
    output = Path(wanted.output).expanduser()
    write_json_tables(output / "metrics.json", findings)
    write_csv(output / "metrics.csv", findings)
    write_grasps_csv(output / "grasps.csv", findings)
    write_latex(output / "tables.tex", findings)
    for row in rows:
        for name, hands in row.hands.items():
            folder = output / "contact" / re.sub("[^a-z0-9]+", "_", row.name.lower()).strip("_")
            write_maps(folder, name, material.meshes[name], hands, row.results[name]["maps"], wanted.scenes)
    write_report(output / "report.html", findings, wanted.pictures, material.cache)
    for sentence in findings.failures:
        print(sentence)
    print(
        f"{output / 'report.html'} shows what was found; figures are in metrics.json, metrics.csv and tables.tex there"
    )


def _measure(material: Material, rows: Sequence[Row]) -> list[Metric]:
    """Fill in the rows' results; the metrics that there are, in the order of the tables."""
    wanted, labels = material.wanted, material.labels
    maps = ContactMaps(labels, wanted.contact_distance)
    protocols = [
        Halo(wanted.halo_samples),
        GraspTTA(),
        Penetration(),
        FingerContact(labels, wanted.contact_distance),
        Posture(labels),
        maps,
    ]
    simulations = []
    if wanted.simulated:
        simulations = [Holding(material.hand, instantiate(wanted.physics), wanted.cache_dir, wanted.simulated)]
    closest = {name: ClosestHand(hands, wanted.vertex_samples) for name, hands in material.truth.items()}
    places = [(row, name) for name in material.objects for row in rows if name in row.hands]
    tasks = [Task(material.meshes[n], row.hands[n], [*protocols, closest[n]]) for row, n in places]
    tasks += [Task(material.meshes[name], hands, [maps]) for name, hands in material.truth.items()]
    for holding in simulations:
        holding.prepare(list(material.meshes.values()), wanted.processes)
        first = slice(wanted.simulated)
        tasks += [Task(material.meshes[name], row.hands[name].select(first), [holding]) for row, name in places]
    results = measured(tasks, material.cache, wanted.processes)
    true_maps = dict(zip(material.truth, results[len(places) :], strict=False))
    for found, simulated in zip(results, results[len(places) + len(true_maps) :], strict=False):
        for title, values in simulated[Holding.name].items():
            protocol, _, metric = title.partition("/")
            found.setdefault(protocol, {})[metric] = values
    for (row, name), found in zip(places, results, strict=False):
        mesh, truth, hands = material.meshes[name], material.truth[name], row.hands[name]
        first = slice(wanted.contact_samples)
        found["table2"]["contact"] = closest_map_error(
            found["maps"]["object"][first] > 0,
            true_maps[name]["maps"]["object"] > 0,
            vertex_areas(mesh.vertices, mesh.faces),
            same_sequence(hands.select(first), truth),
        )
        nearest, held_out = found["table2"].pop("nearest"), closest[name].held_out
        if len(held_out) and (nearest >= 0).any():
            found["coverage"] = {"reached": diversity.reached(nearest, len(held_out))}
        if (points := labels.keypoints(hands)) is not None:
            found["novelty"] = {"distance": diversity.novelty(points, material.training_keypoints)}
        row.results[name] = found
    for row in rows:
        points = [labels.keypoints(hands) for hands in row.hands.values()]
        if all(p is not None for p in points):
            row.clusters = diversity.cluster(np.concatenate(points), wanted.seed)
    contact = Metric("table2", "contact", "%", CLOSEST_MAP, "lower", wanted.contact_samples)
    first, *rest = [metric for p in (next(iter(closest.values())), *protocols, *simulations) for metric in p.metrics]
    return [first, contact, *rest, *diversity.METRICS]


def _failures(rows: Sequence[Row], objects: Sequence[str]) -> list[str]:
    """A sentence for every object and reason for which simulations failed."""
    sentences = []
    for name in objects:
        found = [row.results.get(name, {}).get(Holding.name) for row in rows]
        told = [reason for of_row in found if of_row for reason in reasons(of_row["reason"])]
        for reason, count in Counter(filter(None, told)).most_common():
            sentences.append(f"{name}: the simulation of {count} of {len(told)} grasps failed: {reason}")
    return sentences


def _reconstruction(material: Material, models: Sequence[EvaluatedModel]) -> list[Errors]:
    wanted = material.wanted
    if not wanted.reconstruction:
        return []
    settings = json.dumps([wanted.source, wanted.data], sort_keys=True)
    errors = []
    for model in models:

        def find(model: EvaluatedModel = model) -> dict[str, np.ndarray]:
            material.data.setup()
            found = list(reconstruction(material.data, material.hand, model.files, instantiate(wanted.source)))
            return {"errors": np.frombuffer(json.dumps(found).encode(), np.uint8)}

        keys = [*model.hashes.values(), settings, *material.fingerprint]
        found = material.cache.get("reconstruction", keys, find)["errors"]
        for network, *values in json.loads(found.tobytes()):
            errors.append(Errors(network if len(models) == 1 else f"{model.name}: {network}", *values))
    return errors


def _record(material: Material, models: Sequence[EvaluatedModel]) -> dict[str, Any]:
    """What the figures were made with."""
    return {
        "models": {
            model.name: {
                kind: {"file": str(path.resolve()), "sha256": model.hashes[kind]} for kind, path in model.files.items()
            }
            for model in models
        },
        "data": {
            "store": str(material.data.store_dir),
            "provenance": material.store.card["provenance"],
            "objects_sha256": {name: mesh.sha256 for name, mesh in material.meshes.items()},
            "ground_truth_grasps": {name: len(hands) for name, hands in material.truth.items()},
        },
        "hand_sha256": sha256(material.hand.v_template.numpy()),
        "config": asdict(material.wanted),
        "provenance": provenance(),
    }
