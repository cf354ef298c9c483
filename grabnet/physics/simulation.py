"""A rigid object among fixed convex solids, let go: the one scene that all checks of stability simulate, in MuJoCo."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import trimesh

if TYPE_CHECKING:
    import mujoco

# Steps from one look at where the object is to the next.
_STRIDE = 10
# Metres: friction against turning and rolling of soft fingertips, whose contact is a patch and not a point.
_TORSION, _ROLLING = 0.02, 0.001


class SimulationError(ValueError):
    """The scene can't be simulated, or what came out can't be trusted; the message says why."""


@dataclass(frozen=True)
class RigidBody:
    """An object for simulation: convex pieces, each (N, 3) corners in metres, and where its mass is.

    centre (3,) metres and inertia (3, 3) m² about it, of 1 kg.
    """

    pieces: Sequence[np.ndarray]
    centre: np.ndarray
    inertia: np.ndarray

    @classmethod
    def of_pieces(cls, pieces: Sequence[np.ndarray]) -> RigidBody:
        """Filled evenly: what collides has mass."""
        hulls = [trimesh.convex.convex_hull(piece) for piece in pieces]
        mass = np.array([hull.volume for hull in hulls]) / sum(hull.volume for hull in hulls)
        centre = mass @ np.stack([hull.center_mass for hull in hulls])
        inertia = np.zeros((3, 3))
        for hull, share in zip(hulls, mass, strict=True):
            arm = hull.center_mass - centre
            inertia += share * (hull.moment_inertia / hull.volume + (arm @ arm) * np.eye(3) - np.outer(arm, arm))
        return cls(pieces, centre, inertia)

    def near(self, points: np.ndarray, margin: float) -> RigidBody:
        """The same body with only those pieces that have any of the points (N, 3) within `margin` of their box."""
        low = np.stack([piece.min(0) for piece in self.pieces]) - margin
        high = np.stack([piece.max(0) for piece in self.pieces]) + margin
        close = ((points > low[:, None]) & (points < high[:, None])).all(2).any(1)
        return replace(self, pieces=[piece for piece, keep in zip(self.pieces, close, strict=True) if keep])


@dataclass(frozen=True)
class Dynamics:
    """friction: sliding coefficient of all surfaces. mass: kg. timestep: seconds."""

    friction: float
    mass: float
    timestep: float


class Motion(NamedTuple):
    """How far the object's centre of mass moved, metres, and how far the object turned, radians."""

    displacement: float
    turn: float


class Simulation:
    """An object held by nothing but fixed solids.

    Args:
        body: the object.
        solids: corners (N, 3) of convex solids, metres, in the object's frame.

    Raises:
        SimulationError: a solid is flat or not finite.
    """

    def __init__(self, body: RigidBody, solids: Iterable[np.ndarray], dynamics: Dynamics):
        import mujoco  # here: an extra

        spec = mujoco.MjSpec()
        spec.option.timestep = dynamics.timestep
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio = 10  # contacts that stick hardly creep
        thing = spec.worldbody.add_body(name="object")
        thing.add_freejoint()
        thing.explicitinertial, thing.mass, thing.ipos = True, dynamics.mass, body.centre
        thing.fullinertia = dynamics.mass * body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        try:
            for i, piece in enumerate(body.pieces):
                _add(spec, thing, f"object{i}", piece, dynamics.friction, contype=1, conaffinity=2)
            for i, solid in enumerate(solids):
                _add(spec, spec.worldbody, f"hand{i}", solid, dynamics.friction, contype=2, conaffinity=1)
            self._model = spec.compile()
            self._data = mujoco.MjData(self._model)
        except (ValueError, RuntimeError, mujoco.FatalError) as error:
            raise SimulationError(_in_one_line(error)) from None
        self._dynamics = dynamics

    @property
    def dynamics(self) -> Dynamics:
        """Constants of what follows: setting them costs less than another scene."""
        return self._dynamics

    @dynamics.setter
    def dynamics(self, dynamics: Dynamics) -> None:
        import mujoco

        model, share = self._model, dynamics.mass / self._dynamics.mass
        model.opt.timestep = dynamics.timestep
        model.geom_friction[:, 0] = dynamics.friction
        if share != 1:
            model.body_mass[1] *= share
            model.body_inertia[1] *= share
            mujoco.mj_setConst(model, self._data)
        self._dynamics = dynamics

    def let_go(self, gravity: Sequence[float], steps: int, limit: float = np.inf) -> Motion:
        """Motion of the object from rest at its own frame.

        Args:
            gravity: (3,) m/s².
            limit: metres of displacement at which the simulation ends early.

        Raises:
            SimulationError: MuJoCo warned of numbers out of bounds or of too little memory.
        """
        import mujoco

        model, data = self._model, self._data
        mujoco.mj_resetData(model, data)
        model.opt.gravity[:] = gravity
        moved = turned = 0.0
        heard = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(_ignore)
        try:
            mujoco.mj_forward(model, data)
            start, orientation = data.xipos[1].copy(), data.xmat[1].reshape(3, 3).copy()
            for stride in [steps % _STRIDE] * (steps % _STRIDE > 0) + [_STRIDE] * (steps // _STRIDE):
                mujoco.mj_step(model, data, nstep=stride)
                mujoco.mj_kinematics(model, data)  # a step leaves places as they were before it
                moved = float(np.linalg.norm(data.xipos[1] - start))
                cosine = (np.trace(orientation.T @ data.xmat[1].reshape(3, 3)) - 1) / 2
                turned = float(np.arccos(np.clip(cosine, -1, 1)))
                if not moved < limit:
                    break
        except (ValueError, RuntimeError, mujoco.FatalError) as error:
            raise SimulationError(_in_one_line(error)) from None
        finally:
            mujoco.set_mju_user_warning(heard)
        for kind, warning in enumerate(data.warning):
            if warning.number:
                raise SimulationError(_in_one_line(mujoco.mju_warningText(kind, warning.lastinfo)))
        if not np.isfinite(moved):
            raise SimulationError("The object's place is not a number.")
        return Motion(moved, turned)


def _add(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, corners: np.ndarray, friction: float, **options: float
) -> None:
    import mujoco

    mesh = spec.add_mesh(name=name)
    mesh.uservert = np.asarray(corners, np.float32).ravel()
    geom = mujoco.mjtGeom.mjGEOM_MESH
    body.add_geom(type=geom, meshname=name, friction=[friction, _TORSION, _ROLLING], condim=4, **options)


def _ignore(warning: str) -> None:
    """MuJoCo would print its warnings, and log them to a file in the current folder; its data tell of them, too."""


def _in_one_line(message: object) -> str:
    return " ".join(str(message).split())
