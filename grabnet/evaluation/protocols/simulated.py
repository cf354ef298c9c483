"""Protocols `grasptta`, `shake` and `volco`: whether the hand holds the object, by the simulation of `drop_test`.

A simulation that fails has no displacement and is no success either: it counts as failed, and as nothing else. Where an
object can't be simulated, all of its grasps fail.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Self

import numpy as np
from hydra.utils import instantiate
from joblib import Parallel, delayed

from grabnet.body.hand import HandModel
from grabnet.cli.progress import track
from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.metrics import FIELD, VOLCO, Metric
from grabnet.evaluation.protocol import PerGrasp
from grabnet.evaluation.protocols.drop_test import Outcome, PhysicsConfig, Simulator, engines
from grabnet.evaluation.scene import GraspScene
from grabnet.geometry.mesh import Mesh
from grabnet.io.files import sha256
from grabnet.physics.decomposition import DecompositionConfig, DecompositionError, convex_pieces

# cm that the object moves at most where `volco` calls a grasp stable.
_STABLE = 2.0
_FAILED = "share of grasps whose simulation failed; they count in no other figure"


class _Simulated(PerGrasp):
    """Base of all three; they share one simulation of each grasp. Up is z of the object's mesh.

    Args:
        hand: whose vertices the hands have; what is simulated is missing for others.
        config: constants of both protocols.
        cache_dir: of convex pieces.
        samples: grasps per object that are simulated.

    Raises:
        UserError: what simulates isn't installed.
    """

    def __init__(self, hand: HandModel, config: PhysicsConfig, cache_dir: str | Path | None, samples: int):
        self.hand = hand
        self.config = config
        self.cache_dir = cache_dir
        self.only_first = samples
        shape = [hand.v_template.numpy(), hand.weights.numpy()]
        self.settings = sha256(json.dumps([asdict(config), engines()], sort_keys=True), *shape)

    @classmethod
    def of(cls, inputs: EvaluationInputs) -> Self | None:
        config = inputs.config
        if not config.simulated:
            return None
        return cls(inputs.hand, instantiate(config.physics), config.cache_dir, config.simulated)

    def prepare(self, meshes: Sequence[Mesh], processes: int) -> None:
        """Cut objects into convex pieces, several at once: processes that share an object would each do it."""
        cutting = (delayed(_cut)(mesh, self.config.decomposition, self.cache_dir) for mesh in meshes)
        pool = Parallel(
            n_jobs=processes, prefer="threads", return_as="generator_unordered"
        )  # CoACD has its own process
        for _ in track(pool(cutting), "Cutting objects into convex pieces", len(meshes)):
            pass

    def _outcomes(self, scene: GraspScene) -> list[tuple[Outcome, Outcome]] | None:
        """Return each grasp's outcomes by `grasptta` and `shake`; None for hands of other vertices."""
        target, vertices = scene.target, scene.hands.vertices
        if vertices.shape[1] != len(self.hand.v_template):
            return None

        def simulate() -> list[tuple[Outcome, Outcome]]:
            try:
                simulator = target.kept(
                    ("simulator", self.settings),
                    lambda: Simulator(target.mesh, self.hand, self.config, self.cache_dir),
                )
                return simulator.both(vertices)
            except DecompositionError as error:
                failed = Outcome(None, None, str(error))
                return [(failed, failed)] * len(vertices)

        return scene.kept(("outcomes", self.settings), simulate)


class Displacement(_Simulated):
    """Third number of `grasptta`: how far the object moves, cm; failed: 1 where the simulation did."""

    name = "grasptta"

    def __init__(self, hand: HandModel, config: PhysicsConfig, cache_dir: str | Path | None, samples: int):
        super().__init__(hand, config, cache_dir, samples)
        test = config.grasptta
        moved = (
            f"how far the object's centre moves when let go for {test.steps} steps of 1/{test.steps_per_second} s, the "
            f"hand fixed, friction {test.friction:g}, {test.mass:g} kg"
        )
        self.metrics = (
            Metric("grasptta", "displacement", "cm", moved, "lower", samples, FIELD, headline=True),
            Metric("grasptta", "failed", "%", _FAILED, "lower", samples, FIELD),
        )

    def __call__(self, scene: GraspScene) -> dict[str, np.ndarray]:
        outcomes = self._outcomes(scene)
        if outcomes is None:
            return _missing(self.metrics, len(scene.hands))
        return _results([outcome for outcome, _ in outcomes])


class Shake(_Simulated):
    """success: 1 where the object moved less than its limit (2 cm) under gravity in all six directions; displacement:
    the farthest, cm; failed: 1 where the simulation did."""

    name = "shake"

    def __init__(self, hand: HandModel, config: PhysicsConfig, cache_dir: str | Path | None, samples: int):
        super().__init__(hand, config, cache_dir, samples)
        seconds = config.shake.steps / config.shake.steps_per_second
        held = (
            "share of grasps in which it moves less than the limit under gravity in each of six directions, "
            f"{seconds:g} s each"
        )
        farthest = (
            "how far the object moves relative to the hand, the farthest of the six; soon after the limit it ends"
        )
        self.metrics = (
            Metric("shake", "success", "%", held, "higher", samples, FIELD, headline=True),
            Metric("shake", "displacement", "cm", farthest, "lower", samples, FIELD),
            Metric("shake", "failed", "%", _FAILED, "lower", samples, FIELD),
        )

    def __call__(self, scene: GraspScene) -> dict[str, np.ndarray]:
        outcomes = self._outcomes(scene)
        if outcomes is None:
            return _missing(self.metrics, len(scene.hands))
        shaken = [outcome for _, outcome in outcomes]
        return _results(shaken) | {"success": _numbers([outcome.success for outcome in shaken])}


class Stability(_Simulated):
    """displacement: as in `grasptta`, cm; stable: 1 where it is less than 2 cm."""

    name = "volco"

    def __init__(self, hand: HandModel, config: PhysicsConfig, cache_dir: str | Path | None, samples: int):
        super().__init__(hand, config, cache_dir, samples)
        moved = "how far the object's centre moves when let go, as in grasptta (SD)"
        stable = f"share of grasps in which it moves less than {_STABLE:g} cm"
        self.metrics = (
            Metric("volco", "displacement", "cm", moved, "lower", samples, VOLCO),
            Metric("volco", "stable", "%", stable, "higher", samples, VOLCO),
        )

    def __call__(self, scene: GraspScene) -> dict[str, np.ndarray]:
        outcomes = self._outcomes(scene)
        if outcomes is None:
            return _missing(self.metrics, len(scene.hands))
        results = _results([outcome for outcome, _ in outcomes])
        moved = results["displacement"]
        return results | {"stable": np.where(np.isnan(moved), np.nan, moved < _STABLE)}


def _results(outcomes: Sequence[Outcome]) -> dict[str, np.ndarray]:
    return {
        "displacement": _numbers([outcome.displacement_cm for outcome in outcomes]),
        "failed": np.array([float(outcome.failure is not None) for outcome in outcomes]),
        "failure": np.array([outcome.failure or "" for outcome in outcomes], str),
    }


def _missing(metrics: Sequence[Metric], n: int) -> dict[str, np.ndarray]:
    return {metric.name: np.full(n, np.nan) for metric in metrics} | {"failure": np.full(n, "")}


def _numbers(values: Sequence[float | None]) -> np.ndarray:
    """Return (N,) float64, NaN for None."""
    return np.array(values, float)


def _cut(mesh: Mesh, config: DecompositionConfig, cache_dir: str | Path | None) -> None:
    with suppress(DecompositionError):  # it is cached, and reported for each grasp
        convex_pieces(mesh, config, cache_dir)
