"""Measuring grasps by several protocols, objects and grasps in parallel, each grasp once."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from joblib import Parallel, delayed
from rich.progress import Progress

from grabnet.evaluation.cache import Arrays, Cache, Table
from grabnet.evaluation.hands import Hands
from grabnet.evaluation.metrics import PerGrasp
from grabnet.evaluation.scene import Scene, Target
from grabnet.geometry.mesh import Mesh

# Grasps that a process measures at a time.
_PORTION = 25
# Seconds of work that are lost at most when the process is killed.
_SAVED_EVERY = 20


@dataclass(frozen=True, eq=False)
class Task:
    """Hands on one object, to be measured by some protocols."""

    mesh: Mesh
    hands: Hands
    protocols: Sequence[PerGrasp]


def measured(tasks: Sequence[Task], cache: Cache, processes: int) -> list[dict[str, Arrays]]:
    """Results of each task by the protocols' names.

    Only what is not cached is measured, and what was measured is kept even if this ends early.

    Args:
        processes: at once; 1 for none but this.
    """
    tables: dict[tuple[str, str, str], Table] = {}

    def table(task: Task, protocol: PerGrasp) -> Table:
        key = (task.mesh.sha256, protocol.name, protocol.settings)
        if key not in tables:
            tables[key] = Table(cache.path(protocol.name, key))
        return tables[key]

    portions = []
    planned: set[tuple[int, str]] = set()
    for task in tasks:
        wanted: dict[tuple[int, ...], list[int]] = {}  # hands by the protocols that still lack them
        for i, key in enumerate(task.hands.keys):
            lacking = []
            for k, protocol in enumerate(task.protocols):
                place = table(task, protocol)
                if key not in place and (id(place), key) not in planned:
                    planned.add((id(place), key))
                    lacking.append(k)
            if lacking:
                wanted.setdefault(tuple(lacking), []).append(i)
        for lacking, members in wanted.items():
            for start in range(0, len(members), _PORTION):
                chosen = np.array(members[start : start + _PORTION])
                portions.append((task, [task.protocols[k] for k in lacking], chosen))
    saved = time.monotonic()
    try:
        for number, results in _computed(portions, processes):
            task, protocols, chosen = portions[number]
            names = [task.hands.keys[i] for i in chosen]
            for protocol, arrays in zip(protocols, results, strict=True):
                table(task, protocol).add(names, arrays)
            if time.monotonic() - saved > _SAVED_EVERY:
                for place in tables.values():
                    place.save()
                saved = time.monotonic()
    finally:
        for place in tables.values():
            place.save()
    return [{p.name: table(task, p).rows(task.hands.keys) for p in task.protocols} for task in tasks]


def _computed(
    portions: Sequence[tuple[Task, Sequence[PerGrasp], np.ndarray]], processes: int
) -> Iterable[tuple[int, list[Arrays]]]:
    """Number and results of each portion, as they come."""
    if not portions:
        return
    pool = Parallel(n_jobs=min(processes, len(portions)), return_as="generator_unordered", batch_size=1)
    jobs = (
        delayed(_measure)(number, task.mesh, task.hands.select(chosen), protocols, processes > 1)
        for number, (task, protocols, chosen) in enumerate(portions)
    )
    total = sum(len(chosen) for _, _, chosen in portions)
    with Progress(transient=True) as progress:
        bar = progress.add_task("Measuring grasps", total=total)
        for number, results in pool(jobs):
            yield number, results
            progress.advance(bar, len(portions[number][2]))


_target: Target | None = None  # the last object of this process: portions come object by object


def _measure(
    number: int, mesh: Mesh, hands: Hands, protocols: Sequence[PerGrasp], one_of_many: bool
) -> tuple[int, list[Arrays]]:
    global _target
    if one_of_many:
        torch.set_num_threads(1)
    if _target is None or _target.mesh.sha256 != mesh.sha256:
        _target = Target(mesh)
    scene = Scene(_target, hands)
    return number, [protocol(scene) for protocol in protocols]
