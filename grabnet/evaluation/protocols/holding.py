"""Protocols `grasptta` and `shake`: whether the hand holds the object, by the simulation of `evaluation.physics`.

A simulation that fails has no displacement and is no success either: it counts as failed, and as nothing else. Where an
object can't be simulated, all of its grasps fail.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from grabnet.body.hand import HandModel
from grabnet.evaluation.metrics import Metric
from grabnet.evaluation.protocols.drop_test import Outcome, PhysicsConfig, Simulator, engines
from grabnet.evaluation.scene import Scene
from grabnet.geometry.mesh import Mesh
from grabnet.io.files import sha256
from grabnet.physics.decomposition import DecompositionConfig, DecompositionError, convex_pieces

_MOVED = "how far the object's centre moves when let go for 35 steps of 1/240 s, the hand fixed, friction 3, 1 kg"
_FARTHEST = "how far the object moves relative to the hand, the farthest of the six; soon after the limit it ends"
_HELD = "share of grasps in which it moves less than the limit under gravity in each of six directions, 1 s each"
_FAILED = "share of grasps whose simulation failed; they count in no other figure"
# Bytes that are kept of why a simulation failed.
_REASON = 240


class Holding:
    """Both simulations of each grasp; up is z of the object's mesh.

    displacement: cm, of `grasptta`, and of `shake`. success: 1 where `shake`'s object moved less than its limit (2 cm)
    in all six directions. failed: 1 where the simulation did; the others are then missing, as they are for hands of
    other vertices than the hand model's. reason: why it failed, as bytes of text; see `reasons`.

    Args:
        hand: whose vertices the hands have. config: constants of both. cache_dir: of convex pieces.
        samples: grasps per object that count.

    Raises:
        UserError: what simulates isn't installed.
    """

    name = "holding"

    def __init__(self, hand: HandModel, config: PhysicsConfig, cache_dir: str | Path | None, samples: int):
        self.hand, self.config, self.cache_dir = hand, config, cache_dir
        self.metrics = (
            Metric("grasptta", "displacement", "cm", _MOVED, "lower", samples),
            Metric("grasptta", "failed", "%", _FAILED, "lower", samples),
            Metric("shake", "success", "%", _HELD, "higher", samples),
            Metric("shake", "displacement", "cm", _FARTHEST, "lower", samples),
            Metric("shake", "failed", "%", _FAILED, "lower", samples),
        )
        shape = [hand.v_template.numpy(), hand.weights.numpy()]
        self.settings = sha256(json.dumps([asdict(config), engines()], sort_keys=True), *shape)

    def prepare(self, meshes: Sequence[Mesh], processes: int) -> None:
        """Cut objects into convex pieces, several at once: processes that share an object would each do it."""
        cutting = (delayed(_cut)(mesh, self.config.decomposition, self.cache_dir) for mesh in meshes)
        Parallel(n_jobs=processes, prefer="threads")(cutting)  # CoACD has a process of its own

    def __call__(self, scene: Scene) -> dict[str, np.ndarray]:
        target, vertices = scene.target, scene.hands.vertices
        found = {m.title: np.full(len(vertices), np.nan) for m in self.metrics}
        found["holding/reason"] = np.zeros((len(vertices), _REASON), np.uint8)
        if vertices.shape[1] != len(self.hand.v_template):
            return found
        try:
            simulator = target.kept("simulator", lambda: Simulator(target.mesh, self.hand, self.config, self.cache_dir))
            outcomes = simulator.both(vertices)
        except DecompositionError as error:
            outcomes = [[Outcome(None, None, str(error))] * 2] * len(vertices)
        for i, pair in enumerate(outcomes):
            for protocol, outcome in zip(("grasptta", "shake"), pair, strict=True):
                found[f"{protocol}/failed"][i] = outcome.failure is not None
                if outcome.failure is not None:
                    text = np.frombuffer(outcome.failure.encode()[:_REASON], np.uint8)
                    found["holding/reason"][i, : len(text)] = text
                    continue
                found[f"{protocol}/displacement"][i] = outcome.displacement_cm
                if outcome.success is not None:
                    found[f"{protocol}/success"][i] = outcome.success
        return found


def reasons(found: np.ndarray) -> list[str]:
    """Why the grasps' simulations failed, in words; empty where they did not.

    Args:
        found: (N, bytes) `reason` of `Holding`.
    """
    return [row.tobytes().rstrip(b"\0").decode(errors="ignore") for row in found]


def _cut(mesh: Mesh, config: DecompositionConfig, cache_dir: str | Path | None) -> None:
    with suppress(DecompositionError):  # which is kept, and told grasp by grasp
        convex_pieces(mesh, config, cache_dir)
