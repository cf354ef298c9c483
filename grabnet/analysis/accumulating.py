"""One pass over a data set: what each sequence adds to the statistics, on disk, so that a pass can continue.

<folder>/recipe.json            what the numbers depend on besides the files
<folder>/<sequence>.npz         about: JSON, the group and the hashes of what was read; <statistic>/<name>: arrays
"""

from __future__ import annotations

import io
import json
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from grabnet.analysis.data_set import DataSet
from grabnet.analysis.frames import ALL, Group, Subset
from grabnet.analysis.rules import Rules
from grabnet.analysis.statistic import Statistic
from grabnet.cli.ends import note
from grabnet.cli.progress import steps
from grabnet.errors import UserError
from grabnet.io.files import sha256, write_bytes
from grabnet.io.litter import clear_litter
from grabnet.io.npz import read_npz
from grabnet.io.recipes import claim
from grabnet.io.state import parsed_json
from grabnet.preprocess.backends import Outcome, by_dask, by_joblib
from grabnet.preprocess.sequence_work import outcome_of

# Raise it when the same sequence and rules would give other numbers.
FORMAT = 3
_ABOUT = {"group": [str], "inputs": {str: str}}


@dataclass(frozen=True)
class Accumulation:
    """What a worker does with the name of a sequence: counts it and writes its part.

    Args:
        data: the data set.
        statistics: to accumulate.
        rules: which frames count.
        folder: of the parts.
    """

    data: DataSet
    statistics: Sequence[type[Statistic]]
    rules: Rules
    folder: Path

    def __call__(self, name: str) -> Outcome:
        """Never raises for what is wrong with the one sequence.

        Raises:
            OSError: the folder cannot be written to.
        """
        torch.set_num_threads(1)
        return outcome_of(name, self.folder, lambda: self._write(name))

    def _write(self, name: str) -> None:
        frames, inputs = self.data.frames(name)
        arrays: dict[str, Any] = {"about": json.dumps({"group": list(frames.group), "inputs": inputs})}
        for kind in self.statistics:
            statistic = kind(self.rules)
            statistic.add(frames)
            arrays |= {f"{kind.name}/{what}": value for (_, what), value in statistic.sums.items()}
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **arrays)
        write_bytes(part_path(self.folder, name), buffer.getvalue())


def part_path(folder: Path, name: str) -> Path:
    return folder / f"{name}.npz"


def accumulate(
    work: Accumulation,
    names: Collection[str],
    workers: int,
    max_deaths: int,
    dask_address: str | None = None,
    subset: Subset = ALL,
) -> tuple[dict[str, Statistic], list[Outcome], set[Group]]:
    """Count what is not counted yet, and add up a subset of it.

    Args:
        work: what to do with each sequence.
        names: of the sequences.
        workers: processes of this machine.
        max_deaths: of workers over one sequence until it counts as failed.
        dask_address: of a cluster that works instead.
        subset: to add up.

    Returns:
        the statistics by name, why sequences could not be counted, and the groups of all that were, chosen or not.

    Raises:
        UserError: the folder holds parts of another data set or by other rules.
    """
    recipe = {"format": FORMAT, "data": work.data.recipe(), "rules": work.rules.of_counting}
    recipe["statistics"] = [kind.name for kind in work.statistics]
    claim(work.folder / "recipe.json", recipe, f"delete {work.folder}, or choose another output=")
    clear_litter(work.folder, "*.*", "*/*.*")
    done = {name for name in names if _is_done(work, name)}
    left = [name for name in names if name not in done]
    failures: dict[str, Outcome] = {}
    with steps(f"Counting {work.data.label}", len(names), len(done)) as counted:
        for outcome in _outcomes(work, left, workers, max_deaths, dask_address):
            counted.advance(about=outcome.name)
            if outcome.failure:
                note(f"{outcome.name} failed: {outcome.failure}")
                failures[outcome.name] = outcome
    statistics, groups = {kind.name: kind(work.rules) for kind in work.statistics}, set()
    for name in names:
        if name not in failures:
            groups.add(_merge(work, part_path(work.folder, name), statistics, subset))
    if groups and not any(group in subset for group in groups):
        there = [sorted({getattr(group, by) for group in groups}) for by in Group._fields]
        said = "; ".join(f"{by}s {', '.join(names[:12])}" for by, names in zip(Group._fields, there, strict=True))
        note(f"{work.data.label} has no sequence of {subset}. It has {said}.")
    return statistics, [failures[name] for name in sorted(failures)], groups


def _outcomes(
    work: Accumulation, names: Sequence[str], workers: int, max_deaths: int, dask_address: str | None
) -> Iterator[Outcome]:
    if not names:
        return iter(())
    if dask_address is not None:
        return by_dask(work, names, dask_address)
    return by_joblib(work, names, min(workers, len(names)), max_deaths)


def _is_done(work: Accumulation, name: str) -> bool:
    """Whether a sequence's part is there, made of the files as they are."""
    path = part_path(work.folder, name)
    if not path.exists():
        return False
    try:
        inputs = _about(read_npz(path), path)["inputs"]
    except UserError:
        note(f"{name} is counted again: {path} is damaged.")
        return False
    folder = work.data.folder
    changed = [file for file in inputs if not (folder / file).exists() or sha256(folder / file) != inputs[file]]
    if changed:
        note(f"{name} is counted again: {folder / changed[0]} has changed.")
    return not changed


def _about(arrays: dict[str, Any], path: Path) -> dict[str, Any]:
    try:
        return parsed_json(str(arrays["about"]).encode(), _ABOUT)
    except (KeyError, ValueError):
        raise UserError(f"{path} is no part of an analysis.") from None


def _merge(work: Accumulation, path: Path, statistics: dict[str, Statistic], subset: Subset) -> Group:
    """Add a part, where its group is of the subset; the group."""
    arrays = read_npz(path)
    group = Group(*_about(arrays, path)["group"])
    for name, statistic in statistics.items() if group in subset else ():
        one, merged = type(statistic)(work.rules), group.merged(statistic.by)
        start = f"{name}/"
        one.sums = {(merged, key.removeprefix(start)): v for key, v in arrays.items() if key.startswith(start)}
        statistic.merge(one)
    return group
