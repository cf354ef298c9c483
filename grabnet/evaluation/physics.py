"""How well hands hold an object that is let go: protocols `grasptta` and `shake`, simulated in MuJoCo."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from grabnet.body.hand import HandModel
from grabnet.errors import UserError
from grabnet.evaluation.decomposition import DecompositionConfig, convex_pieces
from grabnet.evaluation.hand_pieces import hand_pieces
from grabnet.evaluation.simulation import Dynamics, RigidBody, Simulation, SimulationError
from grabnet.geometry.mesh import Mesh

# What physics needs beside what every task does: pip's extra of that name.
_EXTRA = ("mujoco", "coacd")


@dataclass(frozen=True)
class Protocol:
    """The constants of a simulation; `configs/evaluation/physics.yaml` explains the values.

    Raises:
        UserError: a value out of range.
    """

    friction: float
    mass: float
    gravity: float
    steps_per_second: int
    steps: int
    limit: float | None

    def __post_init__(self):
        for name in ("friction", "mass", "gravity", "steps_per_second", "steps", "limit"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise UserError(f"The simulation's {name}={value} must be a positive number.")

    @property
    def dynamics(self) -> Dynamics:
        return Dynamics(self.friction, self.mass, 1 / self.steps_per_second)


@dataclass(frozen=True)
class PhysicsConfig:
    """The values of `configs/evaluation/physics.yaml`."""

    grasptta: Protocol
    shake: Protocol
    decomposition: DecompositionConfig


@dataclass(frozen=True)
class Outcome:
    """What became of one grasp.

    Attributes:
        displacement_cm: how far the object's centre of mass moved; of several directions of gravity, the farthest. A
            direction ends within ten steps of its protocol's limit, so that beyond it this says only that it fell.
            None where the simulation failed.
        success: whether it stayed below the limit in all directions; None where there is no limit, or it failed.
        failure: why the simulation failed, or None.
    """

    displacement_cm: float | None
    success: bool | None
    failure: str | None = None


class Simulator:
    """Lets go of an object in hands of one topology.

    The hand is fixed: a convex hull around the vertices of each phalanx and of each tile of the palm. The object is
    convex pieces, filled evenly. Both are rigid, and nothing else is there, no table either. Where they overlap at the
    start, contacts push the object out. Each grasp is simulated by itself from rest: order and number don't matter.

    Args:
        mesh: the object, metres.
        hand: model whose vertices the hands have, in its order.
        cache_dir: of convex pieces; default `$GRABNET_CACHE`, else `grabnet` in the user's cache folder.

    Raises:
        UserError: the mesh can't be cut into convex pieces, or what simulates isn't installed.
    """

    def __init__(self, mesh: Mesh, hand: HandModel, config: PhysicsConfig, cache_dir: str | Path | None = None):
        if missing := [name for name in _EXTRA if find_spec(name) is None]:
            raise UserError(f"Simulation needs {' and '.join(missing)}: pip install -e '.[evaluation]'.")
        self.config = config
        self.body = RigidBody.of_pieces(convex_pieces(mesh, config.decomposition, cache_dir))
        self.n_vertices = len(hand.v_template)
        self.pieces = hand_pieces(hand.weights.cpu().numpy(), hand.v_template.cpu().numpy())

    def grasptta(self, vertices: np.ndarray, up: ArrayLike = (0.0, 0.0, 1.0)) -> list[Outcome]:
        """Let go for 35 steps of 1/240 s (Jiang et al. 2021; spec 9).

        Args:
            vertices: (B, V, 3) metres, in the frame of the object's mesh.
            up: (3,) or (B, 3) unit vectors, what is up in that frame.

        Raises:
            UserError: hands of other than the hand model's vertices.
        """
        down = -np.broadcast_to(up, (len(vertices), 3))
        return self._outcomes(self.config.grasptta, vertices, down[:, None])

    def shake(self, vertices: np.ndarray) -> list[Outcome]:
        """Let go for a second six times, with gravity along either direction of each axis of the mesh's frame.

        Args, Raises:
            as `grasptta`.
        """
        six = np.concatenate([np.eye(3), -np.eye(3)])
        return self._outcomes(self.config.shake, vertices, np.broadcast_to(six, (len(vertices), 6, 3)))

    def _outcomes(self, protocol: Protocol, vertices: np.ndarray, directions: np.ndarray) -> list[Outcome]:
        """Args: directions (B, D, 3), unit vectors along which gravity pulls in turn."""
        if vertices.ndim != 3 or vertices.shape[1:] != (self.n_vertices, 3):
            raise UserError(
                f"Hands of shape {vertices.shape} can't be simulated: their vertices must be the {self.n_vertices} of "
                "the hand model, whose skinning weights tell which belong to which bone; name another hand_model."
            )
        return [self._outcome(protocol, *grasp) for grasp in zip(vertices, directions, strict=True)]

    def _outcome(self, protocol: Protocol, hand: np.ndarray, directions: np.ndarray) -> Outcome:
        limit = math.inf if protocol.limit is None else protocol.limit
        try:
            simulation = Simulation(self.body, [hand[piece] for piece in self.pieces], protocol.dynamics)
            moved = max(
                simulation.let_go(protocol.gravity * direction, protocol.steps, limit).displacement
                for direction in directions
            )
        except SimulationError as error:
            return Outcome(None, None, str(error))
        return Outcome(100 * moved, None if protocol.limit is None else moved < limit)
