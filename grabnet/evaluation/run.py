"""Evaluating grasps: what `scripts/evaluate.py` does."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from hydra.utils import instantiate

from grabnet.body.hand import HandModel
from grabnet.cache import default_cache
from grabnet.data.datamodule import SPLITS, GraspDataModule
from grabnet.data.frames import FramesStore
from grabnet.data.objects import object_files
from grabnet.errors import UserError
from grabnet.evaluation import diversity
from grabnet.evaluation.baseline import lookalike, transplanted
from grabnet.evaluation.cache import Cache
from grabnet.evaluation.contact_maps import ContactMaps, write_maps
from grabnet.evaluation.fingers import FingerContact, vertex_areas
from grabnet.evaluation.generated import drawn, read_grasps
from grabnet.evaluation.grasptta import GraspTTA
from grabnet.evaluation.ground_truth import (
    CLOSEST_MAP,
    ClosestHand,
    closest_map_error,
    ground_truth_row,
    recorded_hands,
    same_sequence,
)
from grabnet.evaluation.halo import Halo
from grabnet.evaluation.hands import HandLabels, Hands
from grabnet.evaluation.holding import Holding
from grabnet.evaluation.measuring import Task, measured
from grabnet.evaluation.metrics import Metric
from grabnet.evaluation.penetration import Penetration
from grabnet.evaluation.posture import Posture
from grabnet.evaluation.reconstruction import Errors, reconstruction
from grabnet.evaluation.report import Findings, write_report
from grabnet.evaluation.summary import Row, figures, surprises
from grabnet.evaluation.tables import write_csv, write_grasps_csv, write_json_tables, write_latex
from grabnet.files import sha256
from grabnet.geometry.mesh import Mesh, load_mesh
from grabnet.models.grabber import Grabber
from grabnet.models.trained import check_hand, find_pair
from grabnet.models.weights import load_coarsenet, load_refinenet, weights_file
from grabnet.provenance import provenance

GROUND_TRUTH, BASELINE = "Ground truth", "Naive baseline"


@dataclass(frozen=True)
class Evaluation:
    """What to evaluate; the values of `configs/evaluate.yaml`, which explains them. data, hand_model, source and
    physics are configs of what their groups make.

    Raises:
        UserError: a value out of range.
    """

    coarsenet: str | None
    refinenet: str | None
    runs: str
    grasps: str | list[str] | None
    output: str
    split: str
    only: list[str] | None
    n: int
    seed: int
    contact_distance: float
    halo_samples: int
    vertex_samples: int
    contact_samples: int
    max_ground_truth: int
    draws: int
    reconstruction: bool
    simulate: bool
    pictures: int
    scenes: int
    processes: int
    cache_dir: str | None
    objects: dict[str, Any]
    hand_model: dict[str, Any]
    data: dict[str, Any]
    source: dict[str, Any]
    physics: dict[str, Any]

    def __post_init__(self):
        least = dict.fromkeys(("n", "halo_samples", "vertex_samples", "contact_samples", "processes"), 1)
        for name, bound in (least | {"max_ground_truth": 2, "draws": 2, "seed": 0, "pictures": 0, "scenes": 0}).items():
            if getattr(self, name) < bound:
                raise UserError(f"{name} is {getattr(self, name)}; it must be at least {bound}.")
        if self.split not in SPLITS:
            raise UserError(f"split is '{self.split}'; it can be {', '.join(SPLITS)}.")
        if not self.contact_distance > 0:
            raise UserError(f"contact_distance is {self.contact_distance}; it must be positive, in metres.")

    @property
    def folders(self) -> list[Path]:
        """Of grasps made elsewhere."""
        named = [self.grasps] if isinstance(self.grasps, str) else self.grasps or []
        return [Path(name).expanduser() for name in named]


class Material:
    """What is evaluated on: hand, true grasps and objects, by the config; read when first asked for."""

    def __init__(self, wanted: Evaluation):
        self.wanted = wanted
        self.hand: HandModel = instantiate(wanted.hand_model)
        self.labels = HandLabels.of(self.hand)
        self.data: GraspDataModule = instantiate(wanted.data, hand=self.hand)
        self.data.prepare_data()
        self.store = FramesStore.load(self.data.store_dir)
        self.files = object_files(self.data.objects_dir)
        self.cache = Cache(Path(wanted.cache_dir or default_cache()) / "evaluation")
        self.objects = self._objects()
        self.meshes: dict[str, Mesh] = {name: load_mesh(self.files[name]) for name in self.objects}
        self.truth: dict[str, Hands] = {
            name: recorded_hands(self.store, self.hand, name, mesh, wanted.max_ground_truth)
            for name, mesh in self.meshes.items()
        }

    def _objects(self) -> list[str]:
        there = [self.store.objects[k] for k in self.store.frames.object.unique().tolist()]
        objects = self.data.objects_of(self.wanted.split, there)
        if unknown := [name for name in self.wanted.only or [] if name not in objects]:
            raise UserError(f"only names {unknown[0]}; the {self.wanted.split} objects are {', '.join(objects)}.")
        objects = self.wanted.only or objects
        if missing := [name for name in objects if name not in self.files]:
            raise UserError(f"{self.data.objects_dir} has no mesh for {', '.join(missing)}.")
        if not objects:
            raise UserError(f"{self.data.store_dir} has no grasp of a {self.wanted.split} object.")
        return objects

    @cached_property
    def training_objects(self) -> list[str]:
        """Names, those of `split` left out where it is the training split itself."""
        there = [self.store.objects[k] for k in self.store.frames.object.unique().tolist()]
        names = [name for name in self.data.objects_of("train", there) if name in self.files]
        return [name for name in names if name not in self.objects]

    @cached_property
    def fingerprint(self) -> list[str]:
        """Of all frames, whom they show and how they are split, of the objects and the hand."""
        frames = [getattr(self.store.frames, name).numpy() for name in self.store.frames.__dataclass_fields__]
        names = [*self.store.objects, "|", *sorted(self.data.split_objects["val"]), "|"]
        names += sorted(self.data.split_objects["test"])
        meshes = [sha256(self.files[name]) for name in self.store.objects if name in self.files]
        hand = [self.hand.v_template.numpy(), self.hand.weights.numpy()]
        return [sha256(*frames), sha256(self.store.v_template.numpy()), sha256(*hand), *names, *meshes]

    @cached_property
    def training_keypoints(self) -> np.ndarray:
        """(M, 21, 3) of the training grasps, for `novelty`."""

        def find() -> dict[str, np.ndarray]:
            names = self.data.objects_of("train", self.store.objects)
            # Where the hand is does not matter: any mesh's centroid will do.
            mesh = next(iter(self.meshes.values()))
            hands = [recorded_hands(self.store, self.hand, name, mesh) for name in names]
            return {"keypoints": np.concatenate([self.labels.keypoints(h) for h in hands if len(h)])}

        return self.cache.get("keypoints", self.fingerprint, find)["keypoints"]


@dataclass(frozen=True)
class Networks:
    """The trained networks to evaluate: their files and hashes, by name."""

    files: dict[str, Path]

    @classmethod
    def of(cls, wanted: Evaluation, hand: HandModel) -> Networks:
        """Those named; where none is, nor any folder of grasps, the newest, or the shipped ones.

        Raises:
            UserError: a RefineNet without a CoarseNet to start from, none there, or trained with another hand.
        """
        if wanted.refinenet and not wanted.coarsenet:
            raise UserError("refinenet is given without coarsenet, from whose grasps it starts: name that, too.")
        if wanted.coarsenet:
            named = {"coarsenet": wanted.coarsenet, "refinenet": wanted.refinenet}
            files = {name: weights_file(path) for name, path in named.items() if path}
        elif not wanted.folders:
            files = dict(zip(("coarsenet", "refinenet"), find_pair(runs=wanted.runs), strict=True))
        else:
            files = {}
        for path in files.values():
            check_hand(path, hand)
        return cls(files)

    @cached_property
    def hashes(self) -> dict[str, str]:
        return {name: sha256(path) for name, path in self.files.items()}

    def grabber(self, hand: HandModel, refine: bool) -> Grabber:
        refinenet = load_refinenet(self.files["refinenet"], hand) if refine else None
        return Grabber(load_coarsenet(self.files["coarsenet"]), refinenet, hand)


def evaluate(wanted: Evaluation) -> None:
    """Measure, and write report.html, metrics.json, metrics.csv, grasps.csv, tables.tex and contact/ to the output
    folder.

    Raises:
        UserError: data, networks or grasps that are missing or do not fit.
    """
    torch.set_num_threads(torch.get_num_threads())  # said explicitly, MKL keeps to it: sums in the same order each time
    material = Material(wanted)
    networks = Networks.of(wanted, material.hand)
    rows = _rows(material, networks)
    metrics = _measure(material, rows)
    found = figures(rows, metrics, material.objects, wanted.draws, wanted.seed)
    findings = Findings(
        rows=rows,
        objects=material.meshes,
        metrics=metrics,
        figures=found,
        errors=_reconstruction(material, networks),
        surprises=surprises(found, rows, metrics),
        split=wanted.split,
        record=_record(material, networks),
    )
    output = Path(wanted.output).expanduser()
    write_json_tables(output / "metrics.json", findings)
    write_csv(output / "metrics.csv", findings)
    write_grasps_csv(output / "grasps.csv", findings)
    write_latex(output / "tables.tex", findings)
    for row in rows:
        for name, hands in row.hands.items():
            folder = output / "contact" / row.name.lower().replace(" + ", "_").replace(" ", "_")
            write_maps(folder, name, material.meshes[name], hands, row.results[name]["maps"], wanted.scenes)
    write_report(output / "report.html", findings, wanted.pictures, material.cache)
    print(
        f"{output / 'report.html'} shows what was found; figures are in metrics.json, metrics.csv and tables.tex there"
    )


def _rows(material: Material, networks: Networks) -> list[Row]:
    wanted = material.wanted
    truth = {name: ground_truth_row(hands, wanted.n, wanted.seed) for name, hands in material.truth.items()}
    rows = [
        Row(GROUND_TRUTH, "recorded grasps of the object, at random, held-out recordings apart", 0, truth, True),
        Row(BASELINE, "training grasps of the object with the most similar BPS, put in the same place", 3, {}, True),
    ]
    files = [material.files[name] for name in material.training_objects]
    for name, mesh in material.meshes.items():
        found = lookalike(mesh, files, material.cache)
        source, origin = material.training_objects[found.number], load_mesh(files[found.number])
        hands = recorded_hands(material.store, material.hand, source, origin)
        chosen = np.random.default_rng([wanted.seed, 3]).permutation(len(hands))[: wanted.n]
        rows[1].hands[name] = transplanted(hands.select(chosen), origin, mesh, found.turn)
        print(f"{BASELINE}: {name} is grasped like {source}")
    for refine in (False, True) if "refinenet" in networks.files else (False,) * len(networks.files):
        used = ("coarsenet", "refinenet") if refine else ("coarsenet",)
        name = "CoarseNet + RefineNet" if refine else "CoarseNet"
        print(f"{name}: {', '.join(str(networks.files[u]) for u in used)}")
        row = Row(name, "drawn from the network" + "s" * refine, 1 if refine else 2, {})
        grabber = networks.grabber(material.hand, refine)
        hashes = [networks.hashes[u] for u in used]
        for thing, mesh in material.meshes.items():
            row.hands[thing] = drawn(
                grabber, hashes, mesh, wanted.n, wanted.seed, material.data.cache_dir, material.cache
            )
        rows.append(row)
    taken = [row.name for row in rows]
    for folder in wanted.folders:
        name = folder.name if folder.name not in taken else str(folder)
        row = Row(name, f"grasps in {folder}", None, {})
        for thing in material.objects:
            hands = read_grasps(folder, thing, material.files[thing], material.hand, wanted.n)
            if hands is not None:
                row.hands[thing] = hands
        if not row.hands:
            raise UserError(f"{folder} has no folder called like an object; these are {', '.join(material.objects)}.")
        if left_out := [thing for thing in material.objects if thing not in row.hands]:
            print(f"{name} has no grasps of {', '.join(left_out)}")
            row.about += f", which has none of {', '.join(left_out)}"
        taken.append(name)
        rows.append(row)
    return rows


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
    if wanted.simulate:
        protocols.append(Holding(material.hand, instantiate(wanted.physics), wanted.cache_dir))
    closest = {name: ClosestHand(hands, wanted.vertex_samples) for name, hands in material.truth.items()}
    places = [(row, name) for name in material.objects for row in rows if name in row.hands]
    tasks = [Task(material.meshes[n], row.hands[n], [*protocols, closest[n]]) for row, n in places]
    tasks += [Task(material.meshes[name], hands, [maps]) for name, hands in material.truth.items()]
    results = measured(tasks, material.cache, wanted.processes)
    true_maps = dict(zip(material.truth, results[len(places) :], strict=True))
    for (row, name), found in zip(places, results, strict=False):
        if simulated := found.pop(Holding.name, None):
            for title, values in simulated.items():
                protocol, _, metric = title.partition("/")
                found.setdefault(protocol, {})[metric] = values
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
    first, *rest = [metric for p in (next(iter(closest.values())), *protocols) for metric in p.metrics]
    return [first, contact, *rest, *diversity.METRICS]


def _reconstruction(material: Material, networks: Networks) -> list[Errors]:
    wanted = material.wanted
    if not wanted.reconstruction or not networks.files:
        return []

    def find() -> dict[str, np.ndarray]:
        material.data.setup()
        refinenet = (
            load_refinenet(networks.files["refinenet"], material.hand) if "refinenet" in networks.files else None
        )
        coarsenet, source = load_coarsenet(networks.files["coarsenet"]), instantiate(wanted.source)
        errors = list(reconstruction(material.data, material.hand, coarsenet, refinenet, source))
        return {"errors": np.frombuffer(json.dumps(errors).encode(), np.uint8)}

    settings = json.dumps([wanted.source, wanted.data], sort_keys=True)
    found = material.cache.get("reconstruction", [*networks.hashes.values(), settings, *material.fingerprint], find)
    return [Errors(*values) for values in json.loads(found["errors"].tobytes())]


def _record(material: Material, networks: Networks) -> dict[str, Any]:
    """What the figures were made with."""
    return {
        "networks": {
            name: {"file": str(path.resolve()), "sha256": networks.hashes[name]}
            for name, path in networks.files.items()
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
