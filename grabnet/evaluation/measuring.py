"""Measuring grasps by several protocols, objects and grasps in parallel, each grasp once."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace

import numpy as np
import torch
from joblib import Parallel, delayed

from grabnet.cli.progress import steps
from grabnet.errors import UserError
from grabnet.evaluation.cache import Arrays, Cache, ResultTable
from grabnet.evaluation.hands import Hands
from grabnet.evaluation.protocol import PerGrasp
from grabnet.evaluation.scene import GraspScene, GraspTarget
from grabnet.geometry.mesh import Mesh

# Grasps that a process measures at a time.
_PORTION = 25
# Seconds of work that are lost at most when the process is killed.
_SAVED_EVERY = 20


@dataclass(frozen=True, eq=False)
class Task:
    """Hands on one object, to be measured by some protocols.

    Attributes:
        key: what the results are returned by.
        mesh: the object.
        hands: of all protocols; of each only the first `only_first`.
        protocols: of these.
        truth: recorded grasps of the object, for protocols that need them.
    """

    key: Hashable
    mesh: Mesh
    hands: Hands
    protocols: Sequence[PerGrasp]
    truth: Hands | None = None


def measured(tasks: Sequence[Task], cache: Cache, processes: int) -> dict[Hashable, Arrays]:
    """Return each task's results, by its key, then by title.

    Only what is not cached is measured, and what was measured is kept even if this ends early.

    Args:
        tasks: of different keys.
        cache: of results.
        processes: at once; 1 for none but this.

    Raises:
        UserError: a process was killed.
        ValueError: two tasks of one key, or two protocols of one task that give a result of one title.
    """
    if len({task.key for task in tasks}) < len(tasks):
        raise ValueError("tasks must have different keys")
    tables: dict[tuple[str, ...], ResultTable] = {}

    def table(task: Task, protocol: PerGrasp) -> ResultTable:
        key = _key(task, protocol)
        if key not in tables:
            tables[key] = ResultTable(cache.path(protocol.name, key))
        return tables[key]

    portions = _portions(tasks, table)
    saved = time.monotonic()
    try:
        for number, results in _computed(portions, processes):
            task = portions[number]
            for protocol, arrays in zip(task.protocols, results, strict=True):
                table(task, protocol).add(task.hands.keys, arrays)
            if time.monotonic() - saved > _SAVED_EVERY:
                for part in tables.values():
                    part.save()
                saved = time.monotonic()
    finally:
        for part in tables.values():
            part.save()
    return {task.key: _by_title(task, table) for task in tasks}


def _by_title(task: Task, table: Callable[[Task, PerGrasp], ResultTable]) -> Arrays:
    results: Arrays = {}
    for protocol in task.protocols:
        for name, array in table(task, protocol).rows(task.hands.keys[: protocol.only_first]).items():
            title = f"{protocol.name}/{name}"
            if title in results:
                raise ValueError(f"two protocols measure {title}")
            results[title] = array
    return results


def _key(task: Task, protocol: PerGrasp) -> tuple[str, ...]:
    """Return all that a protocol's results depend on, but for the hand."""
    kind = type(protocol)
    key = (task.mesh.sha256, f"{kind.__module__}.{kind.__qualname__}", protocol.settings)
    return (*key, task.truth.key) if protocol.needs_truth else key


def _portions(tasks: Sequence[Task], table: Callable[[Task, PerGrasp], ResultTable]) -> list[Task]:
    """Return what no table has yet, each once, as tasks of few hands."""
    portions = []
    planned: set[tuple[int, str]] = set()
    for task in tasks:
        tables = [table(task, protocol) for protocol in task.protocols]
        members: dict[tuple[int, ...], list[int]] = {}  # hands by the protocols that still lack them
        for i, key in enumerate(task.hands.keys):
            lacking = []
            for k, (protocol, part) in enumerate(zip(task.protocols, tables, strict=True)):
                if protocol.only_first is not None and i >= protocol.only_first:
                    continue
                if key not in part and (id(part), key) not in planned:
                    planned.add((id(part), key))
                    lacking.append(k)
            if lacking:
                members.setdefault(tuple(lacking), []).append(i)
        for lacking, index in members.items():
            protocols = [task.protocols[k] for k in lacking]
            truth = task.truth if any(protocol.needs_truth for protocol in protocols) else None
            for start in range(0, len(index), _PORTION):
                hands = task.hands.select(np.array(index[start : start + _PORTION]))
                portions.append(replace(task, hands=hands, protocols=protocols, truth=truth))
    return portions


def _computed(portions: Sequence[Task], processes: int) -> Iterable[tuple[int, list[Arrays]]]:
    """Yield number and results of each portion, as they come."""
    if not portions:
        return
    pool = Parallel(n_jobs=min(processes, len(portions)), return_as="generator_unordered", batch_size=1)
    jobs = (delayed(_measure)(number, task, processes > 1) for number, task in enumerate(portions))
    with steps("Measuring grasps", sum(len(task.hands) for task in portions)) as counted:
        try:
            for number, results in pool(jobs):
                yield number, results
                counted.advance(len(portions[number].hands))
        except BrokenProcessPool:
            raise UserError(
                "A process that measured grasps was killed, perhaps for want of memory. What was measured is kept: run "
                f"the same command again, with fewer processes than {processes}."
            ) from None


_target: GraspTarget | None = None  # the last object of this process: portions come object by object


def _measure(number: int, task: Task, one_of_many: bool) -> tuple[int, list[Arrays]]:
    global _target
    if one_of_many:
        torch.set_num_threads(1)
    if _target is None or _target.mesh.sha256 != task.mesh.sha256:
        _target = GraspTarget(task.mesh)
    scene = GraspScene(_target, task.hands, task.truth)
    return number, [protocol(scene) for protocol in task.protocols]
