"""Protocols `grasptta` and `shake`: whether the hand holds the object, by the simulation of `evaluation.physics`.

A simulation that fails has no displacement and is no success either: it counts as failed, and as nothing else.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from grabnet.body.hand import HandModel
from grabnet.evaluation.hands import Hands
from grabnet.evaluation.metrics import Metric
from grabnet.evaluation.physics import PhysicsConfig, Simulator
from grabnet.evaluation.scene import Scene
from grabnet.files import sha256

_MOVED = "how far the object's centre moves when let go for 35 steps of 1/240 s, the hand fixed, friction 3, 1 kg"
_FARTHEST = "how far the object moves relative to the hand, the farthest of the six; it ends soon after the limit"
_HELD = "share of grasps in which it moves less than the limit under gravity in each of six directions, 1 s each"
_FAILED = "share of grasps whose simulation failed; they count in no other figure"


class Holding:
    """Both simulations of each grasp; up is z of the object's mesh.

    displacement: cm, of `grasptta`, and of `shake`. success: 1 where `shake`'s object moved less than its limit (2 cm)
    in all six directions. failed: 1 where the simulation did; the others are then missing, as they are for hands of
    other vertices than the hand model's.

    Args:
        hand: whose vertices the hands have. config: constants of both. cache_dir: of convex pieces.
        samples: grasps per object that count.
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
        self.settings = sha256(json.dumps(asdict(config), sort_keys=True), *shape)

    def fits(self, hands: Hands) -> bool:
        """Whether these hands can be simulated."""
        return hands.vertices.shape[1] == len(self.hand.v_template)

    def __call__(self, scene: Scene) -> dict[str, np.ndarray]:
        target, vertices = scene.target, scene.hands.vertices
        found = {m.title: np.full(len(vertices), np.nan) for m in self.metrics}
        if not self.fits(scene.hands):
            return found
        simulator = target.kept("simulator", lambda: Simulator(target.mesh, self.hand, self.config, self.cache_dir))
        for protocol, outcomes in (("grasptta", simulator.grasptta(vertices)), ("shake", simulator.shake(vertices))):
            for i, outcome in enumerate(outcomes):
                found[f"{protocol}/failed"][i] = outcome.failure is not None
                if outcome.failure is None:
                    found[f"{protocol}/displacement"][i] = outcome.displacement_cm
                    if outcome.success is not None:
                        found[f"{protocol}/success"][i] = outcome.success
        return found
