"""Simulating whether hands hold an object: what of it is setting up the scene, and what the object's pieces spare."""

from __future__ import annotations

import numpy as np
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf

from grabnet.benchmarks.run import BenchmarkConfig
from grabnet.benchmarks.scene import hands, meshes
from grabnet.benchmarks.timing import Case
from grabnet.evaluation.protocols.drop_test import Simulator
from grabnet.io.shipped import shipped
from grabnet.open.grasps.stability import StabilityConfig, cut
from grabnet.physics.simulation import Simulation

CONFIG = shipped("configs") / "evaluate.yaml"


def cases(settings: BenchmarkConfig) -> list[Case]:
    config = instantiate(OmegaConf.load(CONFIG).physics)
    thing = meshes()[1]
    hand, parameters = hands(settings.batch, torch.Generator().manual_seed(settings.seed), "cpu")
    vertices = hand(parameters).vertices.numpy()
    # Palms on the object: the middle of each hand comes to a point of its surface.
    points, normals = thing.sample_surface(settings.batch, settings.seed)
    vertices += (points + 0.015 * normals - vertices.mean(1))[:, None]
    simulator = Simulator(thing, hand, config)
    cells = cut(thing, np.full(len(thing.vertices), np.inf), StabilityConfig())

    def plain() -> None:
        for hand_vertices in vertices:
            solids = [hand_vertices[piece] for piece in simulator.pieces]
            Simulation(cells, solids, config.grasptta.dynamics).let_go((0, 0, -9.81), config.grasptta.steps)

    def scenes() -> None:
        for hand_vertices in vertices:
            solids = [hand_vertices[piece] for piece in simulator.pieces]
            Simulation(simulator.body, solids, config.grasptta.dynamics)

    lattice = f"grasptta, {len(cells.pieces)} cells of a lattice"
    pieces = len(simulator.body.pieces)
    return [
        Case(lattice, plain, runs=3),
        Case("scenes alone", scenes),
        Case(f"grasptta, {pieces} pieces", lambda: simulator.grasptta(vertices), (lattice, "scenes alone")),
        Case(f"shake, {pieces} pieces", lambda: simulator.shake(vertices), ("scenes alone",), runs=3),
        Case(f"both in one scene, {pieces} pieces", lambda: simulator.both(vertices), ("scenes alone",), runs=3),
    ]
