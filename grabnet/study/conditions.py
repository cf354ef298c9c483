"""The grasps that a study compares: rows of the evaluation, and the recorded grasps moved to be catch trials."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from hydra.utils import instantiate
from omegaconf import DictConfig

from grabnet.cli.entry import compose
from grabnet.errors import UserError
from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.methods import Method, Row, method_rows
from grabnet.geometry.mesh import Mesh
from grabnet.study.catches import Catches
from grabnet.study.config import ExportConfig
from grabnet.study.key import ALL, CATCH, EXAMPLE, Shown


@dataclass(frozen=True, eq=False)
class Grasp:
    """A grasp to show.

    shown: what it is.
    vertices: (V, 3) and faces (F, 3) of the closed hand, in the frame of the object's mesh, metres.
    """

    shown: Shown
    vertices: np.ndarray
    faces: np.ndarray


@dataclass(frozen=True, eq=False)
class StudyGrasps:
    """All grasps of a study.

    conditions: names, ground truth first.
    meshes: of the objects, by name.
    grasps: of all conditions, the catch trials, and of the first object two examples, plausible and implausible.
    record: what they were made with.
    """

    conditions: list[str]
    meshes: dict[str, Mesh]
    grasps: list[Grasp]
    record: dict[str, Any]


def study_grasps(config: ExportConfig) -> StudyGrasps:
    """The grasps that the config names.

    Raises:
        UserError: conditions, objects, models or data that are missing, or too few grasps.
    """
    inputs = EvaluationInputs(instantiate(_evaluation(config), _convert_="object"))
    rows = _chosen(method_rows(inputs), config)
    _refuse_reserved("condition", [row.name for row in rows], (CATCH, EXAMPLE))
    _refuse_reserved("object", inputs.objects, (CATCH, ALL))
    methods = [row.make() for row in rows]
    grasps = [grasp for method in methods for name in inputs.objects for grasp in _of(method, name, config.n)]
    for number, name in enumerate(inputs.objects):
        truth, seed = inputs.truth[name], config.seed
        catches = Catches(inputs.meshes[name], config.catch, seed)
        examples = 1 if number == 0 else 0
        hands, made = catches.make(truth, config.catches + examples, seed)
        faces = truth.closed[1]
        for i, (vertices, how) in enumerate(zip(hands, made, strict=True)):
            condition = CATCH if i < config.catches else EXAMPLE
            grasps.append(Grasp(Shown(name, condition, i, how), vertices, faces))
        if examples:
            used = {how["source"] for how in made}
            plausible = next((i for i in range(len(truth) - 1, -1, -1) if i not in used), 0)
            grasps.append(Grasp(Shown(name, EXAMPLE, plausible), truth.closed[0][plausible], faces))
    record = {
        "models": {model.name: model.record() for model in inputs.models},
        "objects_sha256": {name: mesh.sha256 for name, mesh in inputs.meshes.items()},
        "hand_sha256": inputs.hand.fingerprint,
    }
    return StudyGrasps([method.name for method in methods], inputs.meshes, grasps, record)


def _refuse_reserved(kind: str, names: Iterable[str], reserved: tuple[str, ...]) -> None:
    """Raise a `UserError` for a name that a study uses itself."""
    for name in names:
        if name.casefold() in reserved:
            raise UserError(f"A {kind} is named '{name}', as a part of every study is: rename its folder or mesh.")


def _evaluation(config: ExportConfig) -> DictConfig:
    """The evaluation's config; of its further values the export's own stand."""
    evaluation = compose("evaluate", config.evaluation)
    by_split = isinstance(config.objects, str)
    evaluation.split = config.objects if by_split else "test"
    evaluation.only = None if by_split else config.objects
    for name in ("models", "runs", "grasps", "n", "seed", "processes"):
        evaluation[name] = getattr(config, name)
    return evaluation


def _chosen(rows: Sequence[Row], config: ExportConfig) -> list[Row]:
    if config.conditions is None:
        # A model's last row has rank 1: parts of it, what is not optimised, and rows without a network come below.
        return [row for row in rows if row.rank is None or row.rank <= 1]
    by_name = {row.name: row for row in rows}
    if unknown := [name for name in config.conditions if name not in by_name]:
        raise UserError(f"conditions names {unknown[0]!r}; the rows are {'; '.join(by_name)}.")
    if len(set(config.conditions)) < len(config.conditions) or len(config.conditions) < 2:
        raise UserError("conditions must name at least two different rows.")
    return sorted((by_name[name] for name in config.conditions), key=lambda row: row.rank != 0)


def _of(method: Method, name: str, n: int) -> list[Grasp]:
    hands = method.hands.get(name)
    if hands is None or len(hands) < n:
        raise UserError(f"{method.name} has {0 if hands is None else len(hands)} grasps of {name}; n asks for {n}.")
    vertices, faces = hands.select(slice(0, n)).closed
    return [Grasp(Shown(name, method.name, i), vertices[i], faces) for i in range(n)]
