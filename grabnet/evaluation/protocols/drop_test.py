"""How well hands hold an object that is let go: protocols `grasptta` and `shake`, simulated in MuJoCo."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from grabnet.body.hand import HandModel
from grabnet.cli.checks import Count, Positive, in_range
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh
from grabnet.physics.decomposition import DecompositionConfig, convex_pieces
from grabnet.physics.hand_pieces import hand_pieces
from grabnet.physics.simulation import Dynamics, RigidBody, Simulation, SimulationError


def engines() -> dict[str, str]:
    """Versions of what simulates, on which results depend.

    Raises:
        UserError: any of it isn't installed.
    """
    try:
        return {name: version(name) for name in ("mujoco", "coacd")}
    except PackageNotFoundError as error:
        raise UserError(f"Simulation needs {error.name}: pip install -e '.[evaluation]'.") from None


@dataclass(frozen=True)
class DropTest:
    """The constants of a simulation; `physics` in `configs/evaluate.yaml` explains the values.

    Raises:
        UserError: a value out of range.
    """

    friction: Positive
    mass: Positive
    gravity: Positive
    steps_per_second: Count
    steps: Count
    limit: Positive | None

    def __post_init__(self):
        in_range(self, "physics.")

    @property
    def dynamics(self) -> Dynamics:
        return Dynamics(self.friction, self.mass, 1 / self.steps_per_second)


@dataclass(frozen=True)
class PhysicsConfig:
    """The values of `physics` in `configs/evaluate.yaml`."""

    grasptta: DropTest
    shake: DropTest
    decomposition: DecompositionConfig


@dataclass(frozen=True)
class Outcome:
    """What became of one grasp.

    Attributes:
        displacement_cm: how far the object's centre of mass moved; of several directions of gravity, the farthest. The
            simulation ends within ten steps of its protocol's limit, whatever directions are left, so that beyond it
            this says only that it fell. None where the simulation failed.
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
        DecompositionError: the mesh can't be cut into convex pieces.
        UserError: what simulates isn't installed.
    """

    def __init__(self, mesh: Mesh, hand: HandModel, config: PhysicsConfig, cache_dir: str | Path | None = None):
        engines()
        self.config = config
        self.body = RigidBody.of_pieces(convex_pieces(mesh, config.decomposition, cache_dir))
        self.n_vertices = len(hand.v_template)
        self.pieces = hand_pieces(hand.weights.cpu().numpy(), hand.v_template.cpu().numpy())

    def grasptta(self, vertices: np.ndarray, up: ArrayLike = (0.0, 0.0, 1.0)) -> list[Outcome]:
        """Let go for 35 steps of 1/240 s (Jiang et al. 2021; ref. 9).

        Args:
            vertices: (B, V, 3) metres, in the frame of the object's mesh.
            up: (3,) or (B, 3) unit vectors, what is up in that frame.

        Raises:
            UserError: hands of other than the hand model's vertices.
        """
        down = -np.broadcast_to(up, (len(vertices), 3))
        return [outcome for (outcome,) in self._outcomes(vertices, [(self.config.grasptta, down[:, None])])]

    def shake(self, vertices: np.ndarray) -> list[Outcome]:
        """Let go for a second six times, with gravity along either direction of each axis of the mesh's frame.

        Args, Raises:
            as `grasptta`.
        """
        return [outcome for (outcome,) in self._outcomes(vertices, [(self.config.shake, self._six(vertices))])]

    def both(self, vertices: np.ndarray) -> list[list[Outcome]]:
        """`grasptta`, z being up, and `shake` of each grasp, in less time than one after the other.

        Args, Raises:
            as `grasptta`.
        """
        down = np.broadcast_to((0.0, 0.0, -1.0), (len(vertices), 1, 3))
        return self._outcomes(vertices, [(self.config.grasptta, down), (self.config.shake, self._six(vertices))])

    def _six(self, vertices: np.ndarray) -> np.ndarray:
        return np.broadcast_to(np.concatenate([np.eye(3), -np.eye(3)]), (len(vertices), 6, 3))

    def _outcomes(self, vertices: np.ndarray, runs: Sequence[tuple[DropTest, np.ndarray]]) -> list[list[Outcome]]:
        """Args: runs: protocols, each with directions (B, D, 3), unit vectors along which gravity pulls in turn."""
        if vertices.ndim != 3 or vertices.shape[1:] != (self.n_vertices, 3):
            raise UserError(
                f"Hands of shape {vertices.shape} can't be simulated: their vertices must be the {self.n_vertices} of "
                "the hand model, whose skinning weights tell which belong to which bone; name another hand_model."
            )
        return [
            self._of_grasp(hand, [(protocol, directions[i]) for protocol, directions in runs])
            for i, hand in enumerate(vertices)
        ]

    def _of_grasp(self, hand: np.ndarray, runs: Sequence[tuple[DropTest, np.ndarray]]) -> list[Outcome]:
        try:
            simulation = Simulation(self.body, [hand[piece] for piece in self.pieces], runs[0][0].dynamics)
        except SimulationError as error:
            return [Outcome(None, None, str(error))] * len(runs)
        return [self._outcome(simulation, *run) for run in runs]

    def _outcome(self, simulation: Simulation, protocol: DropTest, directions: np.ndarray) -> Outcome:
        limit = math.inf if protocol.limit is None else protocol.limit
        simulation.dynamics = protocol.dynamics
        farthest = 0.0
        try:
            for direction in directions:
                moved = simulation.let_go(protocol.gravity * direction, protocol.steps, limit).displacement
                farthest = max(farthest, moved)
                if farthest >= limit:
                    break
        except SimulationError as error:
            return Outcome(None, None, str(error))
        return Outcome(100 * farthest, None if protocol.limit is None else farthest < limit)
