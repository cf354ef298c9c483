"""The command that makes open sequences: what is recorded, attempt after attempt, in one process or several."""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from grabnet.body.hand import HandModel
from grabnet.body.whole import OPEN_BODY, BodyModel
from grabnet.cli.ends import note
from grabnet.cli.progress import steps
from grabnet.data.objects import OBJECT_MESHES
from grabnet.data.sequences import write_sequence
from grabnet.errors import UserError
from grabnet.geometry.mesh import load_mesh
from grabnet.io.files import sha256, write_json
from grabnet.io.litter import clear_litter
from grabnet.io.provenance import provenance
from grabnet.io.recipes import claim
from grabnet.io.state import Finite, Kind, read_json
from grabnet.open.body.subjects import open_subjects, write_subjects
from grabnet.open.grasps.store import OPEN_GRASPS, OpenGrasps, load_open_grasps
from grabnet.open.objects.writing import write_objects
from grabnet.open.sequences.actor import Actor
from grabnet.open.sequences.checks import RecordingMeasures, measure
from grabnet.open.sequences.labelling import with_contact
from grabnet.open.sequences.performance import InfeasibleError
from grabnet.open.sequences.plans import Planner
from grabnet.open.sequences.props import Holds, StageProp
from grabnet.open.sequences.setting import TABLE_HEIGHTS, Table
from grabnet.open.sequences.uses import use_of
from grabnet.open.sequences.writing import to_sequence, write_table

# Raise it when the same seed and number would give another recording.
FORMAT = 2
SHARES = {"use": 0.43, "pass": 0.28, "lift": 0.2, "offhand": 0.09}  # of the recordings, about GRAB's
_LIES_AS_MODELLED = 0.75  # share of draws in which the object stands as it was modelled
_ATTEMPTS = 30
_REPORTS = "reports"
_REPORT: Kind = {"rejected": {str: int}, "frames?": Finite(0), "given_up?": int}


@dataclass(frozen=True)
class Entry:
    """One recording to make.

    Attributes:
        number: of the recording.
        name: of its file below `grab`, such as s1/mug_drink_1.
        subject: who acts.
        object: what with.
        intent: which of `SHARES`.
    """

    number: int
    name: str
    subject: str
    object: str
    intent: str

    @property
    def action(self) -> str:
        """What is done, as in "drink" or "lift"."""
        return self.name.rsplit("_", 2)[1]


def build_sequences(
    root: str | Path, number: int, seed: int = 0, processes: int = 2, subjects: Sequence[str] | None = None
) -> None:
    """Write `number` sequences, meshes of objects and subjects, and `sequences.json` (provenance) below `root`.

    Sequences that are there already are kept: a call that was interrupted goes on. Each depends on seed and number.

    Args:
        subjects: names; all ten when omitted.

    Raises:
        UserError: numbers that ask for nothing, an unknown subject, or sequences there that were made otherwise.
    """
    root, grasps = Path(root), load_open_grasps()
    if number < 1 or processes < 1:
        raise UserError(f"--number {number} and --processes {processes} must be at least 1.")
    if unknown := sorted(set(subjects or ()) - set(grasps.subjects)):
        raise UserError(f"There is no subject {', '.join(unknown)}; choose from {', '.join(grasps.subjects)}.")
    recipe = {
        "format": FORMAT,
        "seed": seed,
        "subjects": list(subjects or grasps.subjects),
        "grasps_sha256": sha256(OPEN_GRASPS),
        "body_sha256": sha256(OPEN_BODY / "SMPLX_NEUTRAL.npz", OPEN_BODY / "subjects.npz"),
    }
    remedy = f"choose another --root, or delete {root / 'grab'} and {root / _REPORTS} first"
    claim(root / _REPORTS / "recipe.json", recipe, remedy)
    clear_litter(root, "*.*", f"{_REPORTS}/*/*.*", "grab/*/*.*", "tools/*/*.*", "tools/*/*/*.*")
    write_objects(root, processes)
    body = BodyModel.open()
    write_subjects(root, body, open_subjects(body, grasps))
    write_table(root)
    with steps("Recording sequences", number) as counted:
        planned, reports = 0, {}
        while (made := sum("given_up" not in report for report in reports.values())) < number:
            planned += number - made  # others take the place of those given up
            entries = schedule(grasps, planned, seed, tuple(recipe["subjects"]))[len(reports) :]
            there = {entry.name: report for entry in entries if (report := _reported(root, entry))}
            counted.advance(sum("given_up" not in report for report in there.values()))
            for entry, report in _made([e for e in entries if e.name not in there], root, seed, processes):
                there[entry.name] = report
                if "given_up" in report:
                    print(f"{entry.name}: given up ({report['rejected']}); another takes its place")
                else:
                    counted.advance()
            reports |= {entry.name: there[entry.name] for entry in entries}
    summary = provenance(
        source="scripts/build_open.py sequences: planned and moved by inverse kinematics; nobody was recorded",
        licence="CC0-1.0",
        recipe=recipe,
        sequences=made,
        frames=sum(report.get("frames", 0) for report in reports.values()),
        rejected=dict(sum((Counter(r["rejected"]) for r in reports.values()), Counter()).most_common()),
        reports=reports,
    )
    write_json(root / "sequences.json", summary)
    note(f"Wrote {made} sequences, {summary['frames']} frames, to {root / 'grab'}.")


def schedule(grasps: OpenGrasps, number: int, seed: int, subjects: Sequence[str]) -> list[Entry]:
    """What to record; the first entries are the same whatever the number."""
    entries: list[Entry] = []
    counts: Counter[tuple[str, str, str]] = Counter()
    objects: list[str] = []
    for i in range(number):
        rng = np.random.default_rng([seed, 0, i])
        if not objects:
            objects = list(rng.permutation(grasps.objects))
        name = objects.pop()
        number_of = grasps.objects.index(name)
        able = [s for k, s in enumerate(grasps.subjects)
                if s in subjects and ((grasps.object == number_of) & (grasps.subject == k)).any()]  # fmt: skip
        if not able:
            able, name = [subjects[i % len(subjects)]], _any_object(grasps, subjects[i % len(subjects)], rng)
        subject = able[rng.integers(len(able))]
        intent = str(rng.choice(list(SHARES), p=list(SHARES.values())))
        if intent == "offhand" and name not in TWO_HANDED:
            intent = "pass"
        action = use_of(name).action if intent == "use" else intent
        counts[subject, name, action] += 1
        k = counts[subject, name, action]
        entries.append(Entry(i, f"{subject}/{name}_{action}_{k}", subject, name, intent))
    return entries


# Symmetric objects, which a left hand can take as a right one does, and large enough for two.
TWO_HANDED = frozenset(
    {
        "airplane", "binoculars", "bowl", "cubelarge", "cup", "cylinderlarge", "duck", "elephant", "flashlight",
        "flute", "fryingpan", "headphones", "mug", "spherelarge", "stanfordbunny", "teapot", "toothbrush", "toothpaste",
        "toruslarge", "train", "waterbottle", "wineglass",
    }
)  # fmt: skip


def _any_object(grasps: OpenGrasps, subject: str, rng: np.random.Generator) -> str:
    own = grasps.object[grasps.subject == grasps.subjects.index(subject)].unique()
    return grasps.objects[int(own[rng.integers(len(own))])]


def _made(entries: Sequence[Entry], root: Path, seed: int, processes: int) -> Iterator[tuple[Entry, dict[str, Any]]]:
    if processes == 1:
        for entry in entries:
            yield entry, record(entry, root, seed)
        return
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        jobs = {pool.submit(record, entry, root, seed): entry for entry in entries}
        for done in as_completed(jobs):
            yield jobs[done], done.result()


def record(entry: Entry, root: Path, seed: int) -> dict[str, Any]:
    """Draw until a recording passes all checks, and write it.

    Returns:
        its report: frames, what the checks measured, and how many draws failed for which reason.
    """
    torch.set_num_threads(1)  # sums in another order would give other motions
    actor, prop = _actor(entry.subject), _prop(root, entry.object)
    holds = Holds(prop, actor, _grasps())
    rejected: Counter[str] = Counter()
    taken_by = "left" if entry.intent == "offhand" and "left" in holds.sides else "right"
    # A thin thing that no hand can take as it lies flat stands on its edge.
    rests = [rest for rest in prop.rests if holds.clears(taken_by, rest).any()] or prop.rests
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, 1, entry.number, attempt])
        rest = rests[0] if rng.random() < _LIES_AS_MODELLED else rests[rng.integers(len(rests))]
        table = Table(rng.uniform(*TABLE_HEIGHTS) + actor.floor)
        heading, spot = rng.uniform(-np.pi, np.pi), rng.normal(0, 0.3, 2)
        try:
            stage = Planner(actor, prop, holds, table, rest, rng).make(entry.intent)
        except InfeasibleError as error:
            rejected[str(error)] += 1
            continue
        sequence = to_sequence(stage, table, entry.name, entry.object, entry.action, heading, spot)
        found = measure(sequence, stage, prop, table)
        if faults := found.beyond(RecordingMeasures()):
            rejected.update(faults)
            continue
        sequence = with_contact(sequence, actor, prop)
        report = {
            "frames": len(sequence),
            "table_height": round(table.top - actor.floor, 4),
            "measures": found.rounded(),
            "held_frames": sum(bool(h) for h in stage.held),
            "attempts": attempt + 1,
            "rejected": dict(rejected),
        }
        write_json(root / _REPORTS / f"{entry.name}.json", report)
        write_sequence(_file(root, entry), sequence)
        return report
    report = {"given_up": _ATTEMPTS, "rejected": dict(rejected)}
    write_json(root / _REPORTS / f"{entry.name}.json", report)
    return report


def _reported(root: Path, entry: Entry) -> dict[str, Any] | None:
    """The report of a recording that is there, or was given up."""
    path = root / _REPORTS / f"{entry.name}.json"
    if not path.exists():
        return None
    report = read_json(path, _REPORT, "delete it to have the recording made again")
    return report if "given_up" in report or _file(root, entry).exists() else None


def _file(root: Path, entry: Entry) -> Path:
    return root / "grab" / f"{entry.name}.npz"


@cache
def _grasps() -> OpenGrasps:
    return load_open_grasps()


@cache
def _actor(subject: str) -> Actor:
    found = {s.name: s for s in _subjects()}
    return Actor(found[subject], _body(), HandModel.open())


@cache
def _body():
    return BodyModel.open()


@cache
def _subjects():
    return open_subjects(_body(), _grasps())


@cache
def _prop(root: Path, name: str) -> StageProp:
    return StageProp(name, load_mesh(root / OBJECT_MESHES / f"{name}.ply", weld=False))
